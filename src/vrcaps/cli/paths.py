"""Checks of paths without further imports: a wrong path is reported before anything is loaded."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from vrcaps.core.errors import InputError
from vrcaps.formats.format import FORMATS


def require_folder(folder: str | Path, what: str) -> None:
    """Check that a folder exists; a URL is not checked.

    Args:
        folder: Folder or URL.
        what: Expected content, with its article, such as ``an episode``.

    Raises:
        InputError: If there is no such folder, or it is a file.
    """
    text = str(folder)
    if "://" in text and not text.startswith("file://"):
        return
    path = Path(text.removeprefix("file://"))
    if not path.is_dir():
        where = f"{folder} is a file" if path.is_file() else f"No folder at {folder}"
        raise InputError(f"{where}. Give the folder of {what}.")


def require_file(path: str | Path, what: str) -> None:
    """Check that a file exists.

    Raises:
        InputError: If there is no such file.
    """
    if not Path(path).is_file():
        where = f"{path} is a folder" if Path(path).is_dir() else f"No file at {path}"
        raise InputError(f"{where}. Give {what}.")


def require_sources(sources: Iterable[str]) -> None:
    """Check that the folders of sources of frames exist, see `formats.io.read_source`.

    Raises:
        InputError: If one does not.
    """
    for source in sources:
        kind, colon, folder = source.partition(":")
        if colon and kind in FORMATS:
            require_folder(folder, f"frames in the layout {kind}")
        else:
            require_folder(source, "an episode, a data set or images")


def require_existing(paths: Iterable[Path], what: str) -> None:
    """Check that files or folders exist.

    Raises:
        InputError: If one does not.
    """
    for path in paths:
        if not path.exists():
            raise InputError(f"Nothing at {path}. Give {what}.")
