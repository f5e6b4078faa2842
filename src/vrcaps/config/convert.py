"""Serialization: trees of frozen dataclasses to and from the plain values of TOML and JSON.

A field's type is the schema: ``bool``, ``int``, ``float``, ``str``, ``None``, ``Literal``, ``Any``,
tuples, dataclasses and unions of these. Infinity is the string ``inf``. If a union has several
dataclasses, the key ``kind`` selects the class by its class variable `kind`. A base class that
`register_family` names stands for the union of its family's classes. Missing keys of a table are
taken from the default value of that table's field. A dataclass whose files differ from its fields
registers its expansion with `register_shorthand`.

A field with ``metadata={"unit": "mm"}`` holds SI units in Python. With ``units=True`` its key is
``<name>_mm`` and its value is in that unit, converted exactly; otherwise keys and values are SI.
``metadata={"key": "direction"}`` gives it another name in such files.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from decimal import Decimal
from functools import cache
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from cattrs import BaseValidationError, ClassValidationError, Converter, IterableValidationError
from cattrs.errors import ForbiddenExtraKeysError, IterableValidationNote
from cattrs.gen import make_dict_structure_fn, override

from vrcaps.config.plain_files import UNITS, as_floats, from_si, stored_fields, to_si
from vrcaps.core.errors import InputError, VrcapsError, nearest

_INFINITE = "inf"
_MAX_NUMBER = Decimal("1e300")
_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a string"}

_SHORTHANDS: dict[type, Callable[[dict[str, Any]], dict[str, Any]]] = {}
_FAMILIES: dict[type, Mapping[str, type]] = {}


class _NotAllowedError(ValueError):
    """A value that does not fit its type; its location is added later."""

    def __init__(self, given: Any, allowed: str, verb: str = "is") -> None:
        super().__init__(f"{verb} {given}. Allowed: {allowed}.")


_STRUCTURE_ERRORS = (BaseValidationError, VrcapsError, ValueError, TypeError, KeyError)
"""Errors that a value of a wrong type may raise."""


def register_shorthand(cls: type, expand: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Let files with units use other keys for a dataclass than its fields.

    Args:
        cls: The dataclass.
        expand: Returns a table with the keys of the fields; values may already be objects.
    """
    _SHORTHANDS[cls] = expand


def register_family(base: type, members: Mapping[str, type]) -> None:
    """Let fields of type `base` hold any class of a family that users can extend.

    Args:
        base: Base class or protocol of the family.
        members: Dataclasses by kind, such as a `Registry`; read whenever a value is converted.
    """
    _FAMILIES[base] = members


def to_plain(value: Any, declared: Any, *, units: bool = False) -> Any:
    """Convert a value of the declared type to plain form.

    Args:
        value: A dataclass, tuple, number, string or None.
        declared: Its type; determines whether a dataclass includes its `kind`.
        units: Write fields in the units of their metadata, as decimals, and omit None.
    """
    if is_dataclass(value):
        hints = type_hints(type(value))
        plain = {
            _key(f, units): _in_unit(
                to_plain(getattr(value, f.name), hints[f.name], units=units), f, units
            )
            for f in stored_fields(value)
        }
        if units:
            plain = {key: item for key, item in plain.items() if item is not None}
        tagged = "" not in classes_by_kind(declared)
        return {"kind": value.kind, **plain} if tagged else plain  # type: ignore[attr-defined]
    if isinstance(value, tuple):
        types_ = _item_types(_member(declared, tuple), len(value))
        return [to_plain(v, t, units=units) for v, t in zip(value, types_, strict=True)]
    return _INFINITE if isinstance(value, float) and value == math.inf else value


def from_plain(declared: Any, plain: Any, *, at: str, units: bool = False) -> Any:
    """Convert plain form to a value of the declared type.

    Args:
        declared: A type as described at the top of this module.
        plain: Contents of a JSON or TOML file; numbers may be decimals.
        at: Location in the file, for messages, such as ``scenario.motion`` or ``mine.toml:``.
        units: Fields are in the units of their metadata.

    Raises:
        InputError: If a key is unknown or missing or a value is not allowed; one line with the
            location, the given and the allowed value.
    """
    try:
        return _converter(units).structure(plain, declared)
    except (ClassValidationError, IterableValidationError, _NotAllowedError, VrcapsError) as error:
        raise _explained(error, at, units) from error


@cache
def type_hints(cls: type) -> dict[str, Any]:
    """Types of a dataclass's fields, without annotations."""
    return get_type_hints(cls)


@cache
def _converter(units: bool) -> Converter:
    """Create the cattrs converter with strict types."""
    converter = Converter(forbid_extra_keys=True)
    for scalar in (bool, int, float, str, types.NoneType):
        converter.register_structure_hook(scalar, _structure_scalar)
    converter.register_structure_hook_func(lambda t: get_origin(t) is Literal, _structure_scalar)
    converter.register_structure_hook(Any, lambda plain, _: as_floats(plain))
    converter.register_structure_hook_func(lambda t: t is dict, lambda p, _: _metadata(p))
    for predicate, factory in (
        (is_dataclass, _table_hook),
        (lambda t: get_origin(t) is tuple, _tuple_hook),
        (lambda t: get_origin(t) in (Union, types.UnionType), _union_hook),
        (lambda t: t in _FAMILIES, _union_hook),  # the last one that fits is used
    ):
        converter.register_structure_hook_factory(
            predicate, lambda declared, make=factory: make(converter, declared, units)
        )
    return converter


def _structure_scalar(plain: Any, declared: Any) -> Any:
    if not _fits(declared, plain):
        raise _NotAllowedError(_abbreviated(plain), _allowed(declared))
    return float(plain) if declared is float else plain


def _metadata(plain: Any) -> dict[str, Any]:
    if not isinstance(plain, Mapping):
        raise _NotAllowedError(_abbreviated(plain), "a table")
    return as_floats(plain)


def _tuple_hook(converter: Converter, declared: Any, units: bool) -> Callable[[Any, Any], tuple]:
    def structure(plain: Any, _: Any) -> tuple:
        if not isinstance(plain, list | tuple):
            raise _NotAllowedError(_abbreviated(plain), _allowed(declared))
        items = get_args(declared)
        if items[-1] is not ... and len(items) != len(plain):
            raise _NotAllowedError(f"{len(plain)} values", str(len(items)), verb="has")
        values = []
        for index, (item, value) in enumerate(
            zip(_item_types(declared, len(plain)), plain, strict=True)
        ):
            try:
                values.append(converter.structure(value, item))
            except _STRUCTURE_ERRORS as error:
                error.add_note(_note(index, item))
                raise IterableValidationError("", [error], declared) from error  # pyright: ignore[reportCallIssue]
        return tuple(values)

    return structure


def _note(index: int, item: Any) -> str:
    """Location of an error in a list, in the form of cattrs."""
    make = cast(Any, IterableValidationNote)  # type checkers see the constructor of `str`
    return make("", index, item)


def _union_hook(converter: Converter, declared: Any, units: bool) -> Callable[[Any, Any], Any]:
    def structure(plain: Any, _: Any) -> Any:
        classes = classes_by_kind(declared)
        if isinstance(plain, Mapping) and classes:
            if "" in classes:
                return converter.structure(plain, classes[""])
            plain = dict(plain)
            kind = plain.pop("kind", None)
            if not isinstance(kind, str) or kind not in classes:
                raise _UnknownKindError(kind, classes)
            return converter.structure(plain, classes[kind])
        for member in _members(declared):
            if _fits(member, plain):
                return converter.structure(plain, member)
        raise _NotAllowedError(_abbreviated(plain), _allowed(declared))

    return structure


class _UnknownKindError(_NotAllowedError):
    """A table of unknown kind."""

    def __init__(self, kind: Any, known: Mapping[str, type]) -> None:
        given = "missing" if kind is None else _abbreviated(kind)
        parts = "; parts after a hyphen are other keys" if "-" in str(kind) else ""
        super().__init__(given, ", ".join(sorted(known)) + parts, verb=".kind is")


def _table_hook(converter: Converter, cls: Any, units: bool) -> Callable[[Any, Any], Any]:
    """Create the hook from a table to a dataclass; partial tables are completed from defaults."""
    hints, known = type_hints(cls), {_key(f, units): f for f in stored_fields(cls)}
    renamed = {
        f.name: override(
            rename=_key(f, units), struct_hook=_unit_hook(converter, f, hints[f.name], units)
        )
        for f in known.values()
    }
    renamed |= {f.name: override(omit=True) for f in fields(cls) if f.name not in renamed}
    structure_whole = make_dict_structure_fn(cls, converter, **renamed)  # type: ignore[arg-type]

    def structure(plain: Any, _: Any) -> Any:
        if isinstance(plain, cls):
            return plain
        if not isinstance(plain, Mapping):
            raise _NotAllowedError(_abbreviated(plain), "a table")
        if units and cls in _SHORTHANDS:
            plain = _SHORTHANDS[cls](dict(plain))
        whole = {
            key: _completed(known[key], hints[known[key].name], value, units)
            if key in known
            else value
            for key, value in plain.items()
        }
        return structure_whole(whole, cls)

    return structure


def _unit_hook(
    converter: Converter, f: Field, declared: Any, units: bool
) -> Callable[[Any, Any], Any]:
    unit = f.metadata.get("unit") if units else None
    if unit is None:
        return lambda plain, _: converter.structure(plain, declared)

    def structure(plain: Any, _: Any) -> Any:
        converter.structure(plain, declared)  # errors are reported in the file's own unit
        return converter.structure(_scaled(plain, unit), declared)

    return structure


def _scaled(plain: Any, unit: str) -> Any:
    """Convert numbers of a unit to SI."""
    if isinstance(plain, list | tuple):
        return [_scaled(item, unit) for item in plain]
    return plain if plain is None or unit not in UNITS else to_si(plain, unit)


def _completed(f: Field, declared: Any, plain: Any, units: bool) -> Any:
    """Complete a partial table with the values of the field's default."""
    default = f.default if f.default_factory is MISSING else f.default_factory()
    if not (isinstance(plain, Mapping) and is_dataclass(default)):
        return plain
    kinds: tuple[Any, ...] = (type(default), *classes_by_kind(declared).values())
    fits = [plain.keys() <= {_key(f, units) for f in fields(cls)} for cls in kinds]
    if "kind" not in plain and not fits[0] and any(fits):  # the kind is reported as missing
        return plain
    whole = to_plain(default, declared, units=units)
    kind = whole.get("kind")
    return {**whole, **plain} if plain.get("kind", kind) == kind else plain


def _explained(error: BaseException, at: str, units: bool) -> InputError:
    """First error of a tree of errors, with its location."""
    if isinstance(error, ClassValidationError):
        return _explained_table(error, at, units)
    if isinstance(error, IterableValidationError):
        first = error.exceptions[0]
        index = next(n.index for n in first.__notes__ if isinstance(n, IterableValidationNote))
        return _explained(first, f"{at}[{index}]", units)
    if isinstance(error, _NotAllowedError):
        text = str(error)
        is_key = text.startswith(".") and not at.endswith(":")
        return InputError(f"{at}{text}" if is_key else f"{at} {text.removeprefix('.')}")
    location = at.removesuffix(":")
    return InputError(f"{location}: {error}" if location else str(error))


def _explained_table(error: ClassValidationError, at: str, units: bool) -> InputError:
    known = {f.name: f for f in stored_fields(error.cl)}
    hints = type_hints(error.cl)
    fields_, others = error.group_exceptions()
    for other in others:
        if isinstance(other, ForbiddenExtraKeysError):
            keys = [_key(f, units) for f in known.values()]
            given = sorted(other.extra_fields)[0]
            location = _titled("Unknown key", _located(at, given))
            return InputError(f"{location}. Allowed: {', '.join(keys)}.{nearest(given, keys)}")
    for other, note in fields_:
        if isinstance(other, KeyError):
            location = _located(at, _key(known[note.name], units))
            return InputError(f"{_titled('Missing key', location)}: {_allowed(hints[note.name])}.")
    for other, note in fields_:
        return _explained(other, _located(at, _key(known[note.name], units)), units)
    return _explained(others[0], at, units)


def _titled(what: str, location: str) -> str:
    """Description of a problem with a key, after the file name if the location has one."""
    file, _, key = location.rpartition(": ")
    return f"{file}: {what[0].lower()}{what[1:]} {key}" if file else f"{what} {key}"


def _located(at: str, key: str) -> str:
    return f"{at}{' ' if at.endswith(':') else '.'}{key}" if at else key


def _key(f: Field, units: bool) -> str:
    name = f.metadata.get("key", f.name) if units else f.name
    return f"{name}_{f.metadata['unit']}" if units and "unit" in f.metadata else name


def _in_unit(plain: Any, f: Field, units: bool) -> Any:
    if not units or "unit" not in f.metadata:
        return plain
    if isinstance(plain, list):
        return [_in_unit(item, f, units) for item in plain]
    return from_si(plain, f.metadata["unit"]) if isinstance(plain, float) else plain


def _members(declared: Any) -> tuple[Any, ...]:
    is_union = get_origin(declared) in (Union, types.UnionType)
    return get_args(declared) if is_union else (declared,)


def _member(declared: Any, origin: type) -> Any:
    return next((m for m in _members(declared) if get_origin(m) is origin), None)


def _item_types(declared: Any, count: int) -> tuple[Any, ...]:
    items = get_args(declared) or (Any, ...)
    return (items[0],) * count if items[-1] is ... else items


def classes_by_kind(declared: Any) -> Mapping[str, type]:
    """Dataclasses of a union or a family by kind; the only one, by an empty string.

    Dataclasses without a kind, next to others, have no plain form.
    """
    members = _members(declared)
    if families := [_FAMILIES[m] for m in members if m in _FAMILIES]:
        return families[0]
    classes = [m for m in members if isinstance(m, type) and is_dataclass(m)]
    if len(classes) == 1:
        return {"": classes[0]}
    return {getattr(cls, "kind"): cls for cls in classes if hasattr(cls, "kind")}  # noqa: B009


def _fits(member: Any, plain: Any) -> bool:
    if member is float:
        return _is_number(plain)
    if member in (bool, int, str):
        return isinstance(plain, member) and (member is bool or not isinstance(plain, bool))
    if member in (None, types.NoneType):
        return plain is None
    if get_origin(member) is Literal:
        return any(plain == option and type(plain) is type(option) for option in get_args(member))
    return get_origin(member) is tuple and isinstance(plain, list | tuple)


def _is_number(plain: Any) -> bool:
    """Return whether a value is a number that a float can hold, or the string for infinity."""
    if isinstance(plain, float):
        return True
    if isinstance(plain, bool) or not isinstance(plain, int | Decimal):
        return plain == _INFINITE
    return Decimal(plain).is_finite() and abs(plain) < _MAX_NUMBER


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
    return " or ".join(dict.fromkeys(words))


def _abbreviated(plain: Any) -> str:
    text = repr(as_floats(plain))
    return text if len(text) <= 60 else f"{text[:57]}..."
