"""Changes of settings by dotted path, for presets and the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar, cast, get_args, get_type_hints

from vrcaps.config.convert import classes_by_kind, from_plain
from vrcaps.core.errors import UnknownNameError

Settings = TypeVar("Settings")


def preset_named(
    presets: Mapping[str, Callable[..., Settings]], name: str
) -> Callable[..., Settings]:
    """Return a preset by name.

    Raises:
        UnknownNameError: If there is none.
    """
    if name not in presets:
        raise UnknownNameError("preset", name, presets)
    return presets[name]


def changed_settings(settings: Settings, changes: Iterable[tuple[str, Any]]) -> Settings:
    """Return settings with changed values.

    Example:
        >>> changed_settings(default(), [("env.actuation", "magnet"), ("learner.epochs", 4)])

    Args:
        settings: A dataclass.
        changes: Dotted path of field names, and plain value, of each change; a part or a list of
            parts may be given by kind.

    Raises:
        UnknownNameError: If there is no such field.
        InputError: If a value is not allowed.
    """
    for path, value in changes:
        settings = _changed(settings, path, value)
    return settings


def _changed(settings: Any, path: str, value: Any) -> Any:
    name, _, rest = path.partition(".")
    known = [f.name for f in fields(settings)] if is_dataclass(settings) else []
    if name not in known:
        raise UnknownNameError("setting", name, known)
    if rest:
        new = _changed(getattr(settings, name), rest, value)
    else:
        new = _from_plain(get_type_hints(type(settings))[name], value, name)
    return replace(cast(Any, settings), **{name: new})


def _from_plain(declared: Any, value: Any, at: str) -> Any:
    """Convert a plain value to a type; parts may be given by kind."""
    kinds = classes_by_kind(declared)
    if (
        isinstance(value, str)
        and kinds
        and "" not in kinds
        and str not in (get_args(declared) or (declared,))
    ):
        if value not in kinds:
            raise UnknownNameError(at, value, kinds)
        return kinds[value]()
    if isinstance(value, list) and get_args(declared):
        return tuple(_from_plain(get_args(declared)[0], item, at) for item in value)
    return from_plain(declared, value, at=at)
