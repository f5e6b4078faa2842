"""Folder of data that vrcaps can regenerate."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

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
