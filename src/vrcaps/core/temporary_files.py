"""Temporary files next to their targets, and removal of those left by killed processes."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

from vrcaps.core.locks import try_lock

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
