"""Commands combined from a dataclass and the options of a part."""

from __future__ import annotations

import inspect
import sys
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, get_type_hints

from tyro.conf import OmitArgPrefixes

from vrcaps.core.errors import MissingExtraError


def command_of(base: type, part: type, examples: str) -> Any:
    """Create a command with the flags of `base` and, as further flags, the fields of `part`.

    Fields of the dataclasses within the part become flags as well, without a prefix.

    Args:
        base: Dataclass of the command; its class attribute `part` is set.
        part: Frozen dataclass whose docstring describes it and its attributes.
        examples: Example lines of the help.
    """
    meaning, attributes, options = inspect.cleandoc(part.__doc__ or "").partition("Attributes:")
    doc = f"{meaning.rstrip()}\n\nFor example:\n{examples}\n\n{attributes}{options}"
    own: dict[str, Any] = {"part": part, "__doc__": doc, "__module__": base.__module__}
    hints = get_type_hints(part)
    inner = [f for f in fields(part) if is_dataclass(hints[f.name])]
    own |= {
        f.name: field(default=f.default, default_factory=f.default_factory)  # type: ignore[call-overload]
        for f in inner
    }
    own["__annotations__"] = {f.name: Annotated[hints[f.name], OmitArgPrefixes] for f in inner}
    return dataclass(frozen=True, kw_only=True)(type(part.__name__, (base, part), own))


def with_env_parts(command: type) -> type:
    """Add the names of all tasks, observations, actuations and rewards to the help of a command.

    Environments are imported only if the help is requested.
    """
    if not {"-h", "--help"} & {*sys.argv}:
        return command
    try:
        from vrcaps.env import ACTUATIONS, OBSERVATIONS, REWARDS, TASKS
    except MissingExtraError:
        return command
    names = {
        "tasks": TASKS,
        "observations": OBSERVATIONS,
        "actuations": ACTUATIONS,
        "rewards": REWARDS,
    }
    lists = "; ".join(f"{noun} {', '.join(parts)}" for noun, parts in names.items())
    about, mark, examples = inspect.cleandoc(command.__doc__ or "").partition("For example:")
    if "Parts of environments:" not in about:
        command.__doc__ = f"{about}Parts of environments: {lists}.\n\n{mark}{examples}"
    return command


def part_of(command: Any) -> Any:
    """Part described by a command's flags."""
    names = inspect.signature(command.part).parameters
    return command.part(**{name: getattr(command, name) for name in names})
