"""Commands combined from a dataclass and the options of a part."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any


def command_of(base: type, part: type, examples: str) -> Any:
    """Create a command with the flags of `base` and, as further flags, the fields of `part`.

    Args:
        base: Dataclass of the command; its class attribute `part` is set.
        part: Frozen dataclass whose docstring describes it and its attributes.
        examples: Example lines of the help.
    """
    meaning, attributes, options = inspect.cleandoc(part.__doc__ or "").partition("Attributes:")
    doc = f"{meaning.rstrip()}\n\nFor example:\n{examples}\n\n{attributes}{options}"
    own: dict[str, Any] = {"part": part, "__doc__": doc, "__module__": base.__module__}
    return dataclass(frozen=True, kw_only=True)(type(part.__name__, (base, part), own))


def part_of(command: Any) -> Any:
    """Part described by a command's flags."""
    names = inspect.signature(command.part).parameters
    return command.part(**{name: getattr(command, name) for name in names})
