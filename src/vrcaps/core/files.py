"""Atomic writing of files and folders, temporary files, checksums, and the cache folder."""

from __future__ import annotations

import atexit
import contextlib
import csv
import errno
import hashlib
import io
import json
import math
import os
import re
import shutil
import tempfile
import uuid
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from vrcaps.core.errors import InputError, StorageError
from vrcaps.core.processes import file_lock, try_lock

TEMPORARY = ".tmp"
"""Suffix of files that are still being written; their names start with a dot."""

_SCRATCH, _HELD = "vrcaps-scratch-", ".lock"

_NAME = re.compile(rf"\..+\.([0-9a-f]{{16}}|[0-9a-f]{{32}}){re.escape(TEMPORARY)}")


def is_temporary(name: str) -> bool:
    """Return whether a file name has the form of `temporary_beside` or of the core."""
    return _NAME.fullmatch(name) is not None


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """Yield an empty temporary file with a unique name next to `path`; removed after the block.

    The process holds a lock on the file, which ends with the process. By it, `remove_stale`
    distinguishes the file of a killed process from that of a running one. The first temporary file
    of a process in a folder removes the stale ones there.
    """
    _remove_stale_once(path.parent)
    while True:
        temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}{TEMPORARY}")
        file = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
        try:
            if os.name != "nt":  # Windows can neither remove nor replace an open file
                try_lock(file)
            if temporary.exists():
                break
        except OSError:
            pass
        os.close(file)  # `remove_stale` of another process preceded the lock
    if os.name == "nt":
        os.close(file)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        if os.name != "nt":
            os.close(file)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield an empty folder in the system's temporary folder; removed after the block.

    Folders left by killed processes of the same user are removed first.
    """
    _remove_stale_scratch()
    with (
        TemporaryDirectory(prefix=_SCRATCH) as name,
        temporary_beside(Path(name) / "new") as lock,
    ):
        lock.rename(lock.with_name(_HELD))  # visible to others once it is locked
        (Path(name) / "files").mkdir()
        yield Path(name) / "files"


def _remove_stale_scratch() -> None:
    """Remove scratch folders whose processes have ended."""
    if os.name == "nt":  # their owner is not known
        return
    for folder in Path(gettempdir()).glob(f"{_SCRATCH}*"):
        with contextlib.suppress(OSError):  # held, or removed by another process meanwhile
            if folder.lstat().st_uid != os.getuid():
                continue
            file = os.open(folder / _HELD, os.O_RDWR | os.O_NOFOLLOW)
            try:
                if try_lock(file):
                    shutil.rmtree(folder)
            finally:
                os.close(file)


def remove_stale(folder: Path) -> None:
    """Remove the temporary files in a folder whose processes have ended; others are kept.

    Without file locks the two cannot be distinguished; then all are kept.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        stale = [Path(entry.path) for entry in entries if is_temporary(entry.name)]
        for path in stale:
            _remove_unlocked(path)


@lru_cache(maxsize=1024)
def _remove_stale_once(folder: Path) -> None:
    """Remove stale files in a folder once per process, since listing a large folder is slow."""
    remove_stale(folder)


def _remove_unlocked(path: Path) -> None:
    """Remove a file unless a process holds it."""
    with contextlib.suppress(OSError):  # held, or removed by another process meanwhile
        file = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
        try:
            if os.name == "nt" or try_lock(file):
                path.unlink()
        finally:
            os.close(file)


MAX_BYTES = 2**32
"""Maximum size of the arrays of one archive, since a header may state any."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`, which replaces `path` if the block succeeds.

    The data are synced to disk first: after a power failure there is either the old file or the
    complete new one. The temporary name is unique, so that concurrent writers of the same file do
    not interfere: the last one to finish wins.
    """
    with temporary_beside(path) as temporary:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)


@contextmanager
def atomic_folder(out: Path) -> Iterator[Path]:
    """Yield an empty folder next to `out`, which becomes `out` on success and is removed otherwise.

    The partial folder of a killed process is replaced.

    Raises:
        InputError: If `out` exists and is not empty.
        FolderInUseError: If another process is writing `out`.
        StorageError: If the location cannot be written.
    """
    out = Path(os.path.abspath(out))
    require_new_folder(out)
    partial = out.with_name(f".{out.name}.partial")
    with file_lock(out.with_name(f".{out.name}.lock"), str(out)):
        try:
            _remove_folder(partial)
            partial.mkdir()
        except OSError as error:
            raise StorageError(f"Cannot write {partial}: {error.strerror}.") from error
        try:
            yield partial
            if out.exists():
                remove_stale(out)
                out.rmdir()
            partial.rename(out)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    sync_folder(out.parent)


def _remove_folder(folder: Path) -> None:
    """Remove a folder with its contents; of a symbolic link only the link."""
    if folder.is_symlink():
        folder.unlink()
    elif folder.exists():
        shutil.rmtree(folder)


def write_bytes(path: Path, data: bytes | Iterable[bytes]) -> None:
    """Write a file atomically.

    Args:
        path: The file to write or replace.
        data: Its bytes, or chunks of them in order.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.writelines([data] if isinstance(data, bytes) else data)


def sync_folder(folder: Path) -> None:
    """Sync the names in a folder to disk; returns immediately on Windows."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # folders of some file systems cannot be synced
            raise
    finally:
        os.close(descriptor)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as a compressed NumPy archive (.npz)."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


def read_arrays(path: Path, max_bytes: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Read the arrays of a NumPy archive.

    Args:
        path: The file.
        max_bytes: Maximum total size of the arrays.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is not an archive, is truncated or damaged, or its arrays are larger.
    """
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            total = sum(member.file_size for member in archive.infolist())
            if total > max_bytes:
                raise ValueError(f"its arrays take {total} bytes, more than {max_bytes}")
            return {
                member.filename.removesuffix(".npy"): decode_array(_member(archive, member))
                for member in archive.infolist()
            }
    except OSError:
        raise
    except Exception as error:  # errors of zipfile and NumPy for damaged data have no common base
        raise ValueError(f"not a complete NumPy archive: {error}") from error


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Bytes of a member; decompression stops at the size that its header states."""
    with archive.open(member) as file:
        return file.read(member.file_size)


def decode_array(data: bytes) -> np.ndarray:
    """Decode the bytes of a NumPy file (.npy); its size is checked before allocation.

    Raises:
        ValueError: If they are not such a file, hold objects, or are fewer than the header states.
    """
    file = io.BytesIO(data)
    try:
        major, _ = np.lib.format.read_magic(file)
        read_header = {
            1: np.lib.format.read_array_header_1_0,
            2: np.lib.format.read_array_header_2_0,
        }[major]
        shape, is_fortran, dtype = read_header(file)
    except Exception as error:  # NumPy raises SyntaxError, TokenError and others
        raise ValueError(f"not a complete NumPy array: {error}") from error
    if dtype.hasobject or dtype.itemsize == 0:
        raise ValueError(f"it contains {dtype}, not numbers")
    offset = file.tell()
    size, rest = math.prod(shape) * dtype.itemsize, len(data) - offset
    if min(shape, default=0) < 0 or size > rest:
        raise ValueError(f"its header states {size} bytes, but it has {rest}")
    values = np.frombuffer(data, dtype, math.prod(shape), offset)
    return values.reshape(shape, order="F" if is_fortran else "C").copy(order="K")


def write_json(path: Path, value: Any) -> None:
    """Write indented JSON in the given key order; NaN is an error."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (text + "\n").encode())


def is_new_folder(folder: Path) -> bool:
    """Return whether a folder is missing, or contains at most temporary files."""
    if not folder.exists():
        return True
    return folder.is_dir() and all(is_temporary(path.name) for path in folder.iterdir())


def require_new_folder(folder: Path) -> None:
    """Check that an output folder is missing or empty.

    Raises:
        InputError: If it is not empty, or is a file.
    """
    if not is_new_folder(folder):
        raise InputError(f"{folder} exists. Give a new or empty folder.")


def files_in(folder: Path) -> list[Path]:
    """All files in a folder and its subfolders, sorted."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV with a header: all names, in the order of their first occurrence."""
    text = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(path, text.getvalue().encode())


def file_sha256(path: Path) -> str:
    """SHA-256 checksum of a file, in hexadecimal.

    Raises:
        OSError: If the file cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_other_folder: ContextVar[Path | None] = ContextVar("other_folder", default=None)


def cache_folder() -> Path:
    r"""Folder of data that vrcaps can regenerate: ``VRCAPS_CACHE``, or the platform's cache folder.

    The platform's folder is ``~/.cache/vrcaps`` (or below ``XDG_CACHE_HOME``) on Linux,
    ``~/Library/Caches/vrcaps`` on macOS, ``%LOCALAPPDATA%\vrcaps\Cache`` on Windows. A user
    without a home folder gets a temporary folder, which this process removes when it exits.
    """
    if (other := _other_folder.get()) is not None:
        return other
    try:
        if chosen := os.environ.get("VRCAPS_CACHE"):
            return Path(chosen).expanduser()
        return user_cache_path("vrcaps", appauthor=False)
    except RuntimeError:  # neither HOME nor an entry in the list of users
        return _temporary_folder()


@cache
def _temporary_folder() -> Path:
    """Temporary cache folder for the lifetime of this process."""
    folder, owner = Path(tempfile.mkdtemp(prefix="vrcaps-")), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # not a process that was forked from it
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    warnings.warn(
        f"This user has no home folder, so organs are kept in {folder} until the process ends. Set "
        "VRCAPS_CACHE to an absolute path to keep them.",
        stacklevel=2,
    )
    return folder


@contextmanager
def cache_in(folder: Path) -> Iterator[None]:
    """Use another folder as the cache in this block, such as an empty one for benchmarks."""
    token = _other_folder.set(folder)
    try:
        yield
    finally:
        _other_folder.reset(token)
