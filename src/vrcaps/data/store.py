"""Store of a data set: a folder here, or a place that a URL names, such as ``s3://bucket/name``.

A store holds whole files under names with slashes. A local one keeps what it was given over a loss
of power; a remote one as its service promises.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any, Protocol

from vrcaps.errors import InputError, MissingExtraError
from vrcaps.files import files_in, sync_folder, write_bytes


class Store(Protocol):
    """Where a data set lies."""

    url: str

    def read(self, name: str) -> bytes:
        """A file's bytes; FileNotFoundError if there is none."""
        ...

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all; a file of that name is replaced."""
        ...

    def names(self, folder: str) -> list[str]:
        """Names of the files right in a folder, sorted; none where there is no folder."""
        ...

    def staging(self, name: str, scratch: Path) -> Path:
        """A local folder in which to prepare a folder of this name."""
        ...

    def put(self, staged: Path, name: str) -> None:
        """Move a prepared folder to its name; nothing happens where it is there already."""
        ...

    def free_bytes(self) -> int | None:
        """Room that is left; None if it is not known."""
        ...


class LocalStore:
    """A folder of this machine or of a shared file system."""

    def __init__(self, folder: Path) -> None:
        """The folder need not exist yet."""
        self.folder, self.url = folder, str(folder)

    def read(self, name: str) -> bytes:
        """A file's bytes."""
        return (self.folder / name).read_bytes()

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, data)
        sync_folder(path.parent)

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder, without those being written."""
        path = self.folder / folder
        if not path.is_dir():
            return []
        return sorted(p.name for p in path.iterdir() if p.is_file() and p.name[0] != ".")

    def staging(self, name: str, scratch: Path) -> Path:
        """A hidden folder beside the data, so that a move is one step."""
        return self.folder / ".staging" / name.replace("/", "_")

    def put(self, staged: Path, name: str) -> None:
        """Move a folder to its name in one step."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.rename(staged, path)
        except OSError:
            if not path.is_dir():
                raise
            shutil.rmtree(staged)  # another worker was first, with the same bytes
        sync_folder(path.parent)

    def free_bytes(self) -> int | None:
        """Room on the disk."""
        folder = self.folder
        while not folder.exists():
            folder = folder.parent
        return shutil.disk_usage(folder).free


class RemoteStore:
    """A place that fsspec reaches."""

    def __init__(self, url: str) -> None:
        """Connects.

        Raises:
            MissingExtraError: If fsspec or what it needs for this kind of URL is not installed.
            InputError: If the kind of URL is unknown.
        """
        try:
            import fsspec
        except ImportError as error:
            raise MissingExtraError("fsspec", "scale") from error
        self.url = url.rstrip("/")
        try:
            self._system: Any
            self._system, self._root = fsspec.core.url_to_fs(self.url)
        except ImportError as error:
            raise MissingExtraError(str(error), "scale") from error
        except ValueError as error:
            raise InputError(f"Cannot open {url}: {error}. Allowed: a folder or a URL.") from error

    def read(self, name: str) -> bytes:
        """A file's bytes."""
        return self._system.cat_file(self._path(name))

    def write(self, name: str, data: bytes) -> None:
        """Write a file; object stores show it when it is whole."""
        self._system.pipe_file(self._path(name), data)
        self._system.invalidate_cache()

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder."""
        self._system.invalidate_cache()
        try:
            found = self._system.ls(self._path(folder), detail=True)
        except FileNotFoundError:
            return []
        files = (entry["name"] for entry in found if entry["type"] == "file")
        return sorted(name.rpartition("/")[2] for name in files)

    def staging(self, name: str, scratch: Path) -> Path:
        """A folder of this machine."""
        return scratch / name.replace("/", "_")

    def put(self, staged: Path, name: str) -> None:
        """Copy all files; the ledger says when they are all there."""
        for path in files_in(staged):
            remote = self._path(f"{name}/{path.relative_to(staged).as_posix()}")
            self._system.pipe_file(remote, path.read_bytes())
        shutil.rmtree(staged)

    def free_bytes(self) -> int | None:
        """Not known."""
        return None

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"


def open_store(url: str | Path) -> Store:
    """The store at a path or URL; nothing is made yet."""
    text = str(url)
    if "://" in text and not text.startswith("file://"):
        return RemoteStore(text)
    return LocalStore(Path(text.removeprefix("file://")))
