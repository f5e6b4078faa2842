"""Checks of arguments, before any verb is imported: words, options and paths in one line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path

from vrcaps.core.errors import InputError, UnknownNameError, nearest
from vrcaps.core.names import leads_into
from vrcaps.formats.format import FORMATS

_BOX = re.compile(r"[╭╮╰╯│─]+|-{4,}|(?<!\S)[|+](?!\S)")
"""Frame around the parser's messages, in Unicode or in ASCII."""
_OPTION = re.compile(r"^ *(?:-\w, )?(--[a-z][\w.-]*)", re.MULTILINE)
_ALIKE = 0.8
"""Minimum similarity at which the name of a policy is taken for a misspelled task."""
_HELP = "Known options: {} --help."
_MISSING = re.compile(r"Missing from vrcaps[^:]*: (.*?) For full helptext")
_EMPTY = re.compile(r"Missing value for argument '(.*?)'")
_CHOICE = re.compile(r"invalid choice '(.*?)' for argument '(.*?)'\. Expected one of (.*?)\. For ")
_VALUE = re.compile(r"Error parsing (\S+): (.*?) Argument helptext: \S+ (\{.*?\}|\S+)")
"""Messages of the parser: missing arguments, no value, a wrong choice, a value of a wrong type."""
_QUOTED = re.compile(r"'(.*?)'")
_TYPES = {"FLOAT": "a number", "INT": "an integer"}


def check_verb(words: Sequence[str], verbs: Iterable[str], nouns: dict[str, str]) -> None:
    """Check the name of a verb, and of the word after it in a group.

    Args:
        words: Arguments before the first option.
        verbs: All verbs, such as ``record`` or ``export coco``.
        nouns: Term for the word after the verb of each group, such as ``format`` for ``export``.

    Raises:
        UnknownNameError: If there is no such verb.
    """
    known = [verb.split() for verb in verbs]
    names = {path[0] for path in known}
    if not words:
        return
    if words[0] not in names:
        raise UnknownNameError("command", words[0], names)
    inner = {path[1] for path in known if path[0] == words[0] and len(path) > 1}
    is_leaf = any(path == [words[0]] for path in known)
    if len(words) < 2 or not inner or words[1] in inner:
        return
    # After `evaluate`, any other word may be a policy.
    if not is_leaf or get_close_matches(words[1], inner, 1, _ALIKE):
        raise UnknownNameError(nouns.get(words[0], f"{words[0]} command"), words[1], inner)


def option_error(message: str, help_text: Callable[[], str], verb: str) -> InputError | None:
    """Convert the parser's message on wrong options to one line; None for any other message.

    Args:
        message: Message of the parser.
        help_text: Returns the help of the verb, which lists all options.
        verb: Words of the verb.
    """
    program = f"vrcaps {verb}".rstrip()
    text, more = " ".join(_BOX.sub(" ", message).split()), _HELP.format(program)
    if unknown := re.search(r"Unrecognized options: (\S+)", text):
        given = unknown[1].rstrip(",").partition("=")[0]
        line = f"{given!r} is one argument too many. {more}"
        if given.startswith("-"):
            listed = {*_OPTION.findall(_BOX.sub(" ", help_text()))} - {"--help"}
            known = (listed or {"--help"}) | (set() if verb else {"--version"})
            line = str(UnknownNameError(f"option of {program}", given, known))
    elif missing := _MISSING.search(text):
        line = f"Missing: {_missing(missing[1])}. {more}"
    elif empty := _EMPTY.search(text):
        line = f"{empty[1]} has no value. {more}"
    elif choice := _CHOICE.search(text):
        names = sorted({*_QUOTED.findall(choice[3])} - {"None"})
        allowed = f"{', '.join(names)}.{nearest(choice[1], names)}"
        line = f"{choice[2]} is {choice[1]!r}. Allowed: {allowed}"
    elif value := _VALUE.search(text):
        given = " ".join(_QUOTED.findall(value[2].partition(". Got errors")[0]))
        allowed = _TYPES.get(value[3], value[3].strip("{}"))
        line = f"{value[1]} is {given!r}. Allowed: {allowed}."
    else:
        return None
    return InputError(line)


def _missing(arguments: str) -> str:
    """Missing arguments: options by name, others by metavariable and meaning."""
    names = []
    for argument in filter(None, map(str.strip, arguments.split("(required)"))):
        name, _, meaning = argument.partition(" ")
        names.append(name if name.startswith("--") else f"{name} ({meaning.strip(' .')})")
    return ", ".join(names)


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
        kind, folder = _parts_of(source)
        layout = f"frames in the layout {kind}" if kind else "an episode, a data set or images"
        require_folder(folder, layout)


def require_outside(out: Path, sources: Iterable[str]) -> None:
    """Check that an output folder is not in a source, which would be read with it the next time.

    Raises:
        InputError: If it is the folder of a source or in it.
    """
    for source in sources:
        _, folder = _parts_of(source)
        if "://" not in folder and leads_into(out, Path(folder)):
            raise InputError(
                f"--out is {out}, in the folder {folder} that is read. Allowed: a folder elsewhere."
            )


def _parts_of(source: str) -> tuple[str, str]:
    """Layout, empty if not stated, and folder of a source of frames."""
    kind, colon, folder = source.partition(":")
    return (kind, folder) if colon and kind in FORMATS else ("", source)


def require_existing(paths: Iterable[Path], what: str) -> None:
    """Check that files or folders exist.

    Raises:
        InputError: If one does not.
    """
    for path in paths:
        if not path.exists():
            raise InputError(f"Nothing at {path}. Give {what}.")


def require_out(path: Path, suffix: str, option: str = "--out") -> None:
    """Check the name and the folder of a file to write, which is the value of an option.

    Raises:
        InputError: If the name does not end in the suffix, or the folder does not exist.
    """
    if path.suffix != suffix:
        raise InputError(f"{option} is {path}. Allowed: a name that ends in {suffix}.")
    if not path.absolute().parent.is_dir():
        raise InputError(
            f"{option} is {path}, but the folder {path.parent} does not exist. Create it first."
        )
