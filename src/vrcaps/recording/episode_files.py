"""Access to the files of an episode: in a local folder or elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Protocol

from vrcaps.core.names import inside
from vrcaps.core.temporary_files import scratch_folder


class EpisodeFiles(Protocol):
    """Files of an episode by name, such as ``front/rgb/000000.png``."""

    @property
    def url(self) -> str:
        """Folder or URL that holds them."""
        ...

    def read(self, name: str) -> bytes:
        """Return the bytes of a file.

        Raises:
            OSError: If it cannot be read.
        """
        ...


@dataclass(frozen=True)
class LocalFiles:
    """Files in a local folder."""

    folder: Path

    @property
    def url(self) -> str:
        """Path of the folder."""
        return str(self.folder)

    def read(self, name: str) -> bytes:
        """Return the bytes of a file; one that a link places outside the folder cannot be read.

        Raises:
            OSError: If it cannot be read.
            InputError: If it lies outside.
        """
        return inside(self.folder, name).read_bytes()


@contextmanager
def file_here(files: EpisodeFiles, name: str) -> Iterator[Path]:
    """Path of a file on this machine: the file itself, or a copy that exists during the block.

    Raises:
        OSError: If it cannot be read.
    """
    if isinstance(files, LocalFiles):
        is_shared = name.startswith("../")  # the organ of its data set
        yield files.folder / name if is_shared else inside(files.folder, name)
        return
    with scratch_folder() as folder:
        path = folder / PurePosixPath(name).name
        path.write_bytes(files.read(name))
        yield path
