"""Names in data and files in folders, checked before their use as paths.

External data may contain any text as the name of a sequence, a split or a file. A valid name is a
relative path that stays below its folder, even if links are followed.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
import unicodedata
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from vrcaps.core.errors import InputError

_LONGEST = 180
"""Bytes of a name in UTF-8; formats make it a file name, of 255 at most with its endings."""
_UNSEEN = ("Cc", "Cs", "Zl", "Zp")
"""Unicode categories of control characters, halves of pairs, and ends of lines and paragraphs."""
_TURNING = ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
"""Classes of characters that change the direction of writing, so that a name looks like another."""
_SYSTEM_FILES = ("thumbs.db", "desktop.ini", "__macosx", "icon\r")
"""Files and folders, in lower case, that Windows and macOS add to a user's folders."""

_DATASET_ID = re.compile(r"((?!data/)[\w-]{2,}/)*[\w-]+-v\d{1,9}", re.ASCII)
"""A folder of one character is not a namespace for Minari; `data` marks a data set."""


def is_dataset_id(text: str) -> bool:
    """Return whether a string identifies a Minari data set, such as ``vrcaps/stomach-v0``."""
    return len(text) <= _LONGEST and _DATASET_ID.fullmatch(text) is not None


def require_dataset_id(dataset_id: str) -> None:
    """Check the identifier of a Minari data set, such as ``vrcaps/stomach-v0``.

    Raises:
        InputError: If it is too long, has other characters, no version, or an impossible folder.
    """
    if not (isinstance(dataset_id, str) and is_dataset_id(dataset_id)):
        given = repr(dataset_id)
        given = given if len(given) <= 80 else f"{given[:77]}..."
        raise InputError(
            f"dataset_id is {given}. Allowed: letters, digits, - and _ with a version, such as "
            f"vrcaps/stomach-v0, up to {_LONGEST}; a folder has two or more and is not data."
        )


def require_name(noun: str, name: Any) -> str:
    """Check that a name in data is a valid relative path on every system.

    Args:
        noun: Kind of the named object, for messages.
        name: The name; slashes separate folders.

    Returns:
        The name.

    Raises:
        InputError: If it is not text, empty, absolute, leads upwards, or has control characters.
    """
    if not (isinstance(name, str) and _is_relative(name)):
        text = repr(name)
        text = text if len(text) <= 80 else f"{text[:77]}..."
        raise InputError(
            f"The name of a {noun} is {text}. Allowed: a relative path of at most {_LONGEST} "
            "bytes without '..', backslashes and control characters."
        )
    return name


def _is_relative(name: str) -> bool:
    windows = PureWindowsPath(name)
    parts = PurePosixPath(name).parts
    return (
        0 < len(name.encode(errors="replace")) <= _LONGEST
        and bool(parts)
        and not windows.anchor
        and not windows.drive
        and all(part.strip(" .") for part in parts)
        and not any(_is_control(character) for character in name)
    )


def _is_control(character: str) -> bool:
    """Return whether a character is a backslash, or one that a terminal does not show as text."""
    return (
        character == "\\"
        or unicodedata.category(character) in _UNSEEN
        or unicodedata.bidirectional(character) in _TURNING
    )


def inside(folder: Path, name: Any) -> Path:
    """Path of a file named in data, below a folder, with links followed.

    Args:
        folder: Folder that must contain the file.
        name: Relative path in the data.

    Returns:
        ``folder / name``.

    Raises:
        InputError: If it is not text, leads out of the folder, or is a pipe, socket or device.
    """
    if not isinstance(name, (str, Path)) or "\0" in str(name):
        raise InputError(f"A file in {folder} has the name {name!r}. Allowed: a relative path.")
    path = folder / name
    if not leads_into(path, folder):
        raise _leads_out(path, folder)
    return regular(path)


def regular(path: Path) -> Path:
    """Path, unless it is a pipe, socket or device, from which reading may never end.

    Raises:
        InputError: If it is one.
    """
    with contextlib.suppress(OSError):
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InputError(f"{path} is a pipe, socket or device. Allowed: a file. Remove it.")
    return path


def require_links_inside(folder: Path, *, hidden: bool = False) -> None:
    """Check that no link in a folder or its subfolders leads out of it.

    Args:
        folder: Folder to check.
        hidden: Whether hidden folders are checked as well, as before files are written.

    Raises:
        InputError: If one does, or a file is a pipe, socket or device; states its path.
    """
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if hidden or not is_hidden(Path(name))]
        for path in (Path(place, name) for name in (*folders, *files)):
            if path.is_symlink() and not leads_into(path, folder):
                raise _leads_out(path, folder)
        for name in files:
            regular(Path(place, name))


def listed(folder: Path, pattern: str) -> list[Path]:
    """Files and folders that match a pattern, sorted, without hidden and system files.

    Names that start with a dot are hidden, such as the `._*` that macOS adds next to each file.

    Args:
        folder: Folder to search.
        pattern: As in `Path.glob`; ``**`` is any depth.
    """
    return sorted(p for p in folder.glob(pattern) if not is_hidden(p.relative_to(folder)))


def is_hidden(path: Path) -> bool:
    """Return whether a relative path has a part that is hidden or added by a system."""
    return any(part.startswith(".") or part.lower() in _SYSTEM_FILES for part in path.parts)


def leads_into(path: Path, folder: Path) -> bool:
    """Return whether a path is a folder or below it, after all links are followed."""
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def _leads_out(path: Path, folder: Path) -> InputError:
    return InputError(
        f"{path} leads out of {folder}. Allowed: files in that folder. Copy them there, or give "
        "the folder that holds them all."
    )
