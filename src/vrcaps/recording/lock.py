"""Lock of a recording's folder: one process writes into it, others are told which."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vrcaps.locks import file_lock

LOCK = ".recording.lock"


@contextmanager
def recording_lock(out: Path) -> Iterator[None]:
    """Holds a folder for one recorder; makes it, and removes it if the block left nothing in it.

    Raises:
        FolderInUseError: If another recorder holds the folder.
        StorageError: If it cannot be written to.
    """
    made = [path for path in (out, *out.parents) if not path.exists()]
    try:
        with file_lock(out / LOCK, f"the episode {out}"):
            yield
    finally:
        with contextlib.suppress(OSError):  # something is in it
            for path in made:
                path.rmdir()
