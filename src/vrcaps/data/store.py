"""Store of a data set: a local folder, or a URL such as ``s3://bucket/name``.

A store holds complete files under names with slashes. A local store survives a power failure; a
remote one has the durability of its service.
"""

from __future__ import annotations

import hashlib
import json
import os
import posixpath
import re
import shutil
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Protocol, TypeVar

from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, StorageError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import remove_stale, sync_folder, temporary_beside
from vrcaps.core.names import inside, regular
from vrcaps.core.processes import FolderInUseError, ProgressReport, file_lock, no_report
from vrcaps.organ.organ_file import organ_glb
from vrcaps.organ.surface import OrganSurface, organ_sha256
from vrcaps.recording.layout import SHARED_ORGANS, EpisodeFiles, LocalFiles, read_head


class Store(Protocol):
    """Storage of a data set; each method raises StorageError if it cannot be reached or written."""

    url: str

    def read(self, name: str) -> bytes:
        """Return the bytes of a file; raise FileNotFoundError if there is none."""
        ...

    def has(self, name: str) -> bool:
        """Return whether a file exists."""
        ...

    def write(self, name: str, data: bytes) -> None:
        """Write a file atomically; an existing file is replaced."""
        ...

    def create(self, name: str, data: bytes) -> bool:
        """Write a new file; return False if it exists or another process creates it first."""
        ...

    def remove(self, name: str) -> None:
        """Remove a file, if it exists."""
        ...

    def is_empty(self) -> bool:
        """Return whether there are no visible files."""
        ...

    def names(self, folder: str) -> list[str]:
        """Names of the files directly in a folder, sorted; none if there is no folder."""
        ...

    def staging(self, name: str) -> Path:
        """Local folder in which to prepare a folder of this name."""
        ...

    def put(self, staged: Path, name: str) -> None:
        """Rename a prepared folder to its final name; do nothing if that exists."""
        ...

    def free_bytes(self) -> int | None:
        """Free space; None if unknown."""
        ...


class LocalStore:
    """Folder on this machine or on a shared file system."""

    def __init__(self, folder: Path) -> None:
        """Initialize; the folder need not exist yet."""
        self.folder = Path(os.path.abspath(folder))
        self.url = str(self.folder)

    def read(self, name: str) -> bytes:
        """Return the bytes of a file."""
        return regular(self.folder / name).read_bytes()

    def has(self, name: str) -> bool:
        """Return whether a file exists."""
        return (self.folder / name).is_file()

    def write(self, name: str, data: bytes) -> None:
        """Write a file atomically."""
        path = inside(self.folder, name)
        with _storage_errors(self.url), self._staged(data) as staged:
            path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(staged, path)
            sync_folder(path.parent)

    def create(self, name: str, data: bytes) -> bool:
        """Write a temporary file and rename it atomically, unless the name is taken."""
        path = inside(self.folder, name)
        with _storage_errors(self.url), self._staged(data) as staged:
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(staged, path)
            except FileExistsError:
                return False
            sync_folder(path.parent)
        return True

    @contextmanager
    def _staged(self, data: bytes) -> Iterator[Path]:
        """Write a complete file in the hidden folder; one left by a killed process is ignored."""
        target = self.staging("file")
        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_beside(target) as path:
            with path.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            yield path

    def remove(self, name: str) -> None:
        """Remove a file, if it exists."""
        with _storage_errors(self.url):
            inside(self.folder, name).unlink(missing_ok=True)

    def is_empty(self) -> bool:
        """Return whether the folder holds only hidden files."""
        if self.folder.exists() and not self.folder.is_dir():
            return False
        return not self.folder.is_dir() or all(p.name[0] == "." for p in self.folder.iterdir())

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder, except those being written."""
        path = self.folder / folder
        if not path.is_dir():
            return []
        with os.scandir(path) as entries:
            return sorted(
                entry.name for entry in entries if entry.name[0] != "." and entry.is_file()
            )

    def staging(self, name: str) -> Path:
        """Hidden folder next to the data, so that a move is atomic."""
        return inside(self.folder, Path(".staging", name.replace("/", "_")))

    def put(self, staged: Path, name: str) -> None:
        """Rename a folder to its final name atomically."""
        path = inside(self.folder, name)
        with _storage_errors(self.url):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.rename(staged, path)
            except OSError:
                if not path.is_dir():
                    raise
                shutil.rmtree(staged)  # another worker was first, with the same bytes
            sync_folder(path.parent)

    def free_bytes(self) -> int | None:
        """Free space on the disk."""
        folder = self.folder
        while not folder.exists():
            folder = folder.parent
        return shutil.disk_usage(folder).free


@contextmanager
def _storage_errors(url: str) -> Iterator[None]:
    """Convert errors of the file system to one line.

    Raises:
        StorageError: If the block raises OSError.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise StorageError(
            f"Cannot write the data set {url}: {reason}. Completed files are kept. Fix the cause "
            "and repeat the command to resume."
        ) from error


def tidy_staging(store: Store) -> None:
    """Remove temporary files and locks of killed processes; those of running ones are kept."""
    folder = store.staging("")
    remove_stale(folder)
    for lock in folder.glob("*.lock"):
        with suppress(FolderInUseError, StorageError), file_lock(lock, str(folder)):
            pass  # removed when it is released


def open_store(url: str | Path) -> Store:
    """Return the store at a path or URL; nothing is created yet."""
    text = str(url)
    if "://" in text and not text.startswith("file://"):
        from vrcaps.data.remote_store import RemoteStore

        return RemoteStore(text)
    return LocalStore(Path(text.removeprefix("file://")))


Item = TypeVar("Item")
Result = TypeVar("Result")

_READS = 32
"""Concurrent reads; reads of a remote store mostly wait."""


@dataclass(frozen=True)
class StoredFiles:
    """Files of an episode in a remote store, in this process and its child processes.

    Attributes:
        store_url: URL of the store.
        folder: Folder of the episode in the store; names may lead out of it, to shared files.
    """

    store_url: str
    folder: str = "."

    @property
    def url(self) -> str:
        """URL of the episode."""
        return self.store_url if self.folder == "." else f"{self.store_url}/{self.folder}"

    def read(self, name: str) -> bytes:
        """Return the bytes of a file."""
        path, root = posixpath.normpath(posixpath.join(self.folder, name)), self.store_url
        while path.startswith("../"):
            path, root = path.removeprefix("../"), root.rpartition("/")[0]
        return _connection(root, os.getpid()).read(path)


def episode_files(store: Store, folder: str = ".") -> EpisodeFiles:
    """Files of an episode in a folder of a store, or at the root of the store."""
    if isinstance(store, LocalStore):
        return LocalFiles(store.folder / folder)
    return StoredFiles(store.url, folder)


def read_at_once(
    read: Callable[[Item], Result],
    items: Collection[Item],
    progress: ProgressReport = no_report,
) -> list[Result]:
    """Read several items at once; results are in the order of the items.

    Args:
        read: Reads one item.
        items: The items.
        progress: Called with the number of read items and the total.
    """
    results = []
    with ThreadPoolExecutor(_READS) as pool:
        for result in pool.map(read, items):
            results.append(result)
            progress(len(results), len(items))
    return results


@lru_cache(maxsize=16)
def _connection(url: str, process: int) -> Store:
    """Store of a URL for a process: a forked process cannot use its parent's."""
    return open_store(url)


_ORGAN_FILE = re.compile(rf"{SHARED_ORGANS}/[0-9a-f]{{64}}\.glb")


@dataclass(frozen=True)
class StoredOrgan:
    """Entry of an organ that recordings of a data set share.

    Attributes:
        path: Name of its file in the data set.
        sha256: Checksum of the file.
        bytes: Size of the file.
    """

    path: str
    sha256: str
    bytes: Annotated[int, Range(0)]

    def __post_init__(self) -> None:
        check_fields(self)
        is_organ = bool(_ORGAN_FILE.fullmatch(self.path))
        require(is_organ, "path", repr(self.path), f"{SHARED_ORGANS}/ and the name of an organ")


def store_organ(store: Store, organ: OrganSurface) -> str:
    """Store an organ if it does not exist yet.

    Returns:
        The path of its file, relative to an episode of the data set.
    """
    name = f"{SHARED_ORGANS}/{organ_sha256(organ)}.glb"
    if _read_entry(store, name) is None:
        data = b"".join(organ_glb(organ, compact=True))
        entry = {"path": name, "sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
        store.write(name, data)
        # Written last: if it exists, the organ is complete.
        store.write(_entry_name(name), (json.dumps(entry) + "\n").encode())
    return f"../../{name}"


def organ_entry(store: Store, episode: Path) -> dict[str, Any] | None:
    """Path in the data set, checksum and size of the organ that an episode names."""
    file = PurePosixPath(read_head(LocalFiles(episode))["organ"]["path"]).name
    return _read_entry(store, f"{SHARED_ORGANS}/{file}")


def _entry_name(name: str) -> str:
    return name.removesuffix(".glb") + ".json"


def _read_entry(store: Store, name: str) -> dict[str, Any] | None:
    """Entry of a stored organ; None if it is missing or damaged."""
    where = _entry_name(name)
    try:
        plain = decode_json(store.read(where), where)
        from_plain(StoredOrgan, plain, at=where)
    except (FileNotFoundError, InputError):
        return None
    return plain
