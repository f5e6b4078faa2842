"""Where the files of an episode lie: in a folder of this machine, or elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Protocol

from vrcaps.names import inside
from vrcaps.temporary_files import scratch_folder


class EpisodeFiles(Protocol):
    """The files of an episode by their names, such as ``front/rgb/000000.png``."""

    @property
    def url(self) -> str:
        """Folder or URL that they lie in."""
        ...

    def read(self, name: str) -> bytes:
        """A file's bytes.

        Raises:
            OSError: If it cannot be read.
        """
        ...


@dataclass(frozen=True)
class LocalFiles:
    """Files in a folder of this machine."""

    folder: Path

    @property
    def url(self) -> str:
        """The folder."""
        return str(self.folder)

    def read(self, name: str) -> bytes:
        """A file's bytes; one that a link places outside the folder cannot be read.

        Raises:
            OSError: If it cannot be read.
            InputError: If it lies outside.
        """
        return inside(self.folder, name).read_bytes()


@contextmanager
def file_here(files: EpisodeFiles, name: str) -> Iterator[Path]:
    """A file on this machine: itself, or a copy that is there during the block.

    Raises:
        OSError: If it cannot be read.
    """
    if isinstance(files, LocalFiles):
        is_shared = name.startswith("../")  # an organ of its data set
        yield files.folder / name if is_shared else inside(files.folder, name)
        return
    with scratch_folder() as folder:
        path = folder / PurePosixPath(name).name
        path.write_bytes(files.read(name))
        yield path
