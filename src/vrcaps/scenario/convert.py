"""Frozen dataclass trees to and from plain values, as JSON and TOML hold them.

A field's type is the schema: ``bool``, ``int``, ``float``, ``str``, ``None``, ``Literal``,
tuples, other dataclasses and unions of these; an infinite number is the text ``inf``. Where a
union has several dataclasses the plain form names the class under the key ``kind``, the text that
the class itself has as `kind`. Keys that a table leaves out are as in the default of its field.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from vrcaps.errors import InputError

_INFINITE = "inf"
_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def to_plain(value: Any, declared: Any) -> Any:
    """Plain form of a value of the declared type.

    Args:
        value: A dataclass, tuple, number, text or None.
        declared: Its type; decides whether a dataclass carries its `kind`.
    """
    if is_dataclass(value):
        hints = get_type_hints(type(value))
        plain = {f.name: to_plain(getattr(value, f.name), hints[f.name]) for f in fields(value)}
        tagged = len(_classes(declared)) > 1
        return {"kind": value.kind, **plain} if tagged else plain  # type: ignore[attr-defined]
    if isinstance(value, tuple):
        items = get_args(_member(declared, tuple)) or (Any, ...)
        types_ = [items[0]] * len(value) if items[-1] is ... else items
        return [to_plain(item, item_type) for item, item_type in zip(value, types_, strict=True)]
    return _INFINITE if isinstance(value, float) and value == math.inf else value


def from_plain(declared: Any, plain: Any, *, at: str) -> Any:
    """Value of the declared type from its plain form.

    Args:
        declared: A type as described on top of this module.
        plain: What a JSON or TOML file holds.
        at: Where in the file it is, for messages, such as ``scenario.motion``.

    Raises:
        InputError: If a key is unknown or missing or a value has the wrong type; one line with
            the place and what is allowed.
    """
    members = _members(declared)
    classes = _classes(declared)
    if isinstance(plain, Mapping) and classes:
        return _dataclass(classes, plain, at)
    for member in members:
        if _fits(member, plain):
            return _convert(member, plain, at)
    raise InputError(f"{at} is {plain!r}. Allowed: {' or '.join(_allowed(m) for m in members)}.")


def _members(declared: Any) -> tuple[Any, ...]:
    is_union = get_origin(declared) in (Union, types.UnionType)
    return get_args(declared) if is_union else (declared,)


def _member(declared: Any, origin: type) -> Any:
    return next((m for m in _members(declared) if get_origin(m) is origin), None)


def _classes(declared: Any) -> dict[str, type]:
    classes = [m for m in _members(declared) if isinstance(m, type) and is_dataclass(m)]
    return {getattr(cls, "kind", cls.__name__): cls for cls in classes}


def _dataclass(classes: dict[str, type], plain: Mapping, at: str) -> Any:
    plain = dict(plain)
    if len(classes) > 1:
        kind = plain.pop("kind", None)
        if kind not in classes:
            given = "missing" if kind is None else repr(kind)
            raise InputError(f"{at}.kind is {given}. Allowed: {', '.join(sorted(classes))}.")
        cls = classes[kind]
    else:
        (cls,) = classes.values()
    hints, known = get_type_hints(cls), {f.name: f for f in fields(cls)}
    unknown = sorted(set(plain) - set(known))
    if unknown:
        raise InputError(f"Unknown key {at}.{unknown[0]}. Allowed: {', '.join(known)}.")
    missing = [name for name, f in known.items() if name not in plain and _is_required(f)]
    if missing:
        raise InputError(f"Missing key {at}.{missing[0]}: {_allowed(hints[missing[0]])}.")
    values = {k: _completed(known[k], hints[k], v) for k, v in plain.items()}
    return cls(**{k: from_plain(hints[k], v, at=f"{at}.{k}") for k, v in values.items()})


def _completed(f: Field, declared: Any, plain: Any) -> Any:
    """A table of some keys with the others as the field's own default has them."""
    default = f.default if f.default_factory is MISSING else f.default_factory()
    if not (isinstance(plain, Mapping) and is_dataclass(default)):
        return plain
    whole = to_plain(default, declared)
    return {**whole, **plain} if plain.get("kind") == whole.get("kind") else plain


def _is_required(f: Field) -> bool:
    return f.default is MISSING and f.default_factory is MISSING


def _fits(member: Any, plain: Any) -> bool:
    if member in (bool, int, float, str):
        allowed = (int, float) if member is float else (member,)
        if member is float and plain == _INFINITE:
            return True
        return isinstance(plain, allowed) and (member is bool or not isinstance(plain, bool))
    if member in (None, types.NoneType):
        return plain is None
    if get_origin(member) is Literal:
        return any(plain == option and type(plain) is type(option) for option in get_args(member))
    return get_origin(member) is tuple and isinstance(plain, list | tuple)


def _convert(member: Any, plain: Any, at: str) -> Any:
    if member is float:
        return float(plain)
    if get_origin(member) is not tuple:
        return plain
    items = get_args(member)
    if items[-1] is ...:
        items = (items[0],) * len(plain)
    if len(items) != len(plain):
        raise InputError(f"{at} has {len(plain)} values. Allowed: {len(items)}.")
    return tuple(
        from_plain(item, value, at=f"{at}[{index}]")
        for index, (item, value) in enumerate(zip(items, plain, strict=True))
    )


def _allowed(declared: Any) -> str:
    words = []
    for member in _members(declared):
        if member in _WORDS:
            words.append(_WORDS[member])
        elif member in (None, types.NoneType):
            words.append("null")
        elif get_origin(member) is Literal:
            words.append(", ".join(repr(option) for option in get_args(member)))
        elif get_origin(member) is tuple:
            words.append("a list")
        else:
            words.append("a table")
    return " or ".join(words)
