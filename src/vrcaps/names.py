"""Names that data state and files that folders hold: checked before they are used as paths.

Data of others may state any text as the name of a sequence, a split or a file. Such a name is a
relative path that stays below its folder, also where links are followed.
"""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from vrcaps.errors import InputError

_LONGEST = 1000
_SYSTEM_FILES = ("thumbs.db", "desktop.ini", "__macosx", "icon\r")
"""Files and folders, in lower case, that Windows and macOS add to those of a user."""


def require_name(noun: str, name: Any) -> str:
    """Check that a name that data state can be a relative path on every system.

    Args:
        noun: Whose name it is, for messages.
        name: The name; slashes separate folders.

    Returns:
        The name.

    Raises:
        InputError: If it is no text, empty, absolute, leads upwards, or has control characters.
    """
    if not (isinstance(name, str) and _is_relative(name)):
        shown = repr(name)
        shown = shown if len(shown) <= 80 else f"{shown[:77]}..."
        raise InputError(
            f"The name of a {noun} is {shown}. Allowed: a relative path without '..', backslashes "
            "and control characters."
        )
    return name


def _is_relative(name: str) -> bool:
    windows = PureWindowsPath(name)
    parts = PurePosixPath(name).parts
    return (
        0 < len(name) <= _LONGEST
        and bool(parts)
        and not windows.anchor
        and not windows.drive
        and all(part.strip(" .") for part in parts)
        and not any(_is_control(character) for character in name)
    )


def _is_control(character: str) -> bool:
    """Whether a character is a control character, a backslash, or not text (half of a pair)."""
    code = ord(character)
    return code < 32 or code == 127 or character == "\\" or 0xD800 <= code <= 0xDFFF


def inside(folder: Path, name: Any) -> Path:
    """Path of a file that data name, in a folder, with links followed.

    Args:
        folder: Which the file must be below.
        name: Relative path, as data state it.

    Returns:
        ``folder / name``.

    Raises:
        InputError: If it is no text, or leads out of the folder.
    """
    if not isinstance(name, (str, Path)) or "\0" in str(name):
        raise InputError(f"A file in {folder} has the name {name!r}. Allowed: a relative path.")
    path = folder / name
    if not _leads_into(path, folder):
        raise _leads_out(path, folder)
    return path


def require_links_inside(folder: Path) -> None:
    """Check that no link in a folder or in those below it leads out of it; hidden ones may.

    Raises:
        InputError: If one does; names it.
    """
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not is_hidden(Path(name))]
        for path in (Path(place, name) for name in (*folders, *files)):
            if path.is_symlink() and not _leads_into(path, folder):
                raise _leads_out(path, folder)


def listed(folder: Path, pattern: str) -> list[Path]:
    """Files and folders that fit a pattern, sorted; without hidden ones and those of systems.

    Hidden are names that begin with a dot, such as the `._*` that macOS puts beside each file.

    Args:
        folder: Where to look.
        pattern: As of `Path.glob`; ``**`` is any depth.
    """
    return sorted(p for p in folder.glob(pattern) if not is_hidden(p.relative_to(folder)))


def is_hidden(path: Path) -> bool:
    """Whether a relative path has a part that is hidden or that a system adds."""
    return any(part.startswith(".") or part.lower() in _SYSTEM_FILES for part in path.parts)


def _leads_into(path: Path, folder: Path) -> bool:
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def _leads_out(path: Path, folder: Path) -> InputError:
    return InputError(
        f"{path} leads out of {folder}. Allowed: files in that folder. Copy them there, or give "
        "the folder that holds them all."
    )
