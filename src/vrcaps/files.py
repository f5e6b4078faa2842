"""Files that appear whole or not at all, and their checksums."""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import json
import math
import os
import shutil
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.errors import InputError, StorageError
from vrcaps.locks import file_lock
from vrcaps.temporary_files import is_temporary, remove_stale, temporary_beside

MOST_BYTES = 2**32
"""Largest size of the arrays of one archive: a header may state any."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, which replaces `path` if the block succeeds.

    It does so when its bytes are on the disk: after a loss of power there is the old file or the
    whole new one. The temporary name is unique, so that processes that write the same file do not
    disturb each other: the last one to finish wins.
    """
    with temporary_beside(path) as temporary:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)


@contextmanager
def atomic_folder(out: Path) -> Iterator[Path]:
    """Empty folder beside `out`, which becomes `out` if the block succeeds and is removed if not.

    The folder of a process that was killed is replaced.

    Raises:
        InputError: If `out` exists and is not empty.
        FolderInUseError: If another process is making `out`.
        StorageError: If the place cannot be written.
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
    """Remove a folder with all that it holds; of a symbolic link only the link."""
    if folder.is_symlink():
        folder.unlink()
    elif folder.exists():
        shutil.rmtree(folder)


def write_bytes(path: Path, data: bytes | Iterable[bytes]) -> None:
    """Write a file whole or not at all.

    Args:
        path: The file to write or replace.
        data: Its bytes, or pieces of them in order.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.writelines([data] if isinstance(data, bytes) else data)


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk; returns at once on Windows."""
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


def read_arrays(path: Path, most_bytes: int = MOST_BYTES) -> dict[str, np.ndarray]:
    """Read the arrays of a NumPy archive.

    Args:
        path: The file.
        most_bytes: Largest size of all arrays together.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is no archive, is cut short or damaged, or its arrays are larger.
    """
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            total = sum(member.file_size for member in archive.infolist())
            if total > most_bytes:
                raise ValueError(f"its arrays take {total} bytes, more than {most_bytes}")
            return {
                member.filename.removesuffix(".npy"): decode_array(_member(archive, member))
                for member in archive.infolist()
            }
    except OSError:
        raise
    except Exception as error:  # what zipfile and NumPy raise for damaged data has no common base
        raise ValueError(f"no whole NumPy archive: {error}") from error


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Bytes of a member; no more are decompressed than its header states."""
    with archive.open(member) as file:
        return file.read(member.file_size)


def decode_array(data: bytes) -> np.ndarray:
    """Array of the bytes of a NumPy file (.npy); its size is checked before it is allocated.

    Raises:
        ValueError: If they are no such file, hold objects, or are fewer than the header states.
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
        raise ValueError(f"no whole NumPy array: {error}") from error
    if dtype.hasobject or dtype.itemsize == 0:
        raise ValueError(f"it holds {dtype}, not numbers")
    size, rest = math.prod(shape) * dtype.itemsize, len(data) - file.tell()
    if min(shape, default=0) < 0 or size > rest:
        raise ValueError(f"its header states {size} bytes, and it has {rest}")
    values = np.frombuffer(data, dtype, math.prod(shape), file.tell())
    return values.reshape(shape, order="F" if is_fortran else "C").copy(order="K")


def write_json(path: Path, value: Any) -> None:
    """Write JSON, indented, in the order of the keys given; NaN is an error."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (text + "\n").encode())


def is_new_folder(folder: Path) -> bool:
    """Whether a folder to be made is not there, or holds at most temporary files."""
    if not folder.exists():
        return True
    return folder.is_dir() and all(is_temporary(path.name) for path in folder.iterdir())


def require_new_folder(folder: Path) -> None:
    """Check that a folder to be made is not there, or is empty.

    Raises:
        InputError: If it is there with something in it, or is a file.
    """
    if not is_new_folder(folder):
        raise InputError(f"{folder} exists. Give a new or empty folder.")


def files_in(folder: Path) -> list[Path]:
    """All files in a folder and those below it, sorted."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV below a header: all names, in the order in which they first come."""
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
