"""Folder lock of a recording: a second writer fails and names the first."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vrcaps.core.locks import file_lock

LOCK = ".recording.lock"


@contextmanager
def recording_lock(out: Path) -> Iterator[None]:
    """Lock a folder for one recorder; create it, and remove it if it is empty after the block.

    Raises:
        FolderInUseError: If another recorder holds the folder.
        StorageError: If it cannot be written to.
    """
    made = [path for path in (out, *out.parents) if not path.exists()]
    try:
        with file_lock(out / LOCK, f"the episode {out}"):
            yield
    finally:
        with contextlib.suppress(OSError):  # it is not empty
            for path in made:
                path.rmdir()
