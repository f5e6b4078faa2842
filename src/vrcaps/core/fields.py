"""Types of a dataclass's fields: numbers and names with limits, and files with checksums.

Limits are declared in the type and checked in the constructor; checksums let a recording be
repeated from the same data.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from numbers import Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.files import file_sha256

_TEXTURE_HEAD = "mucosa.json"


@dataclass(frozen=True)
class Range:
    """Limits of a number, for `Annotated[float, Range(above=0.0)]`; None and ``inf`` are open.

    Attributes:
        min: Minimum, inclusive.
        max: Maximum, inclusive.
        above: Lower bound, exclusive.
        below: Upper bound, exclusive.
        unit: Unit, for messages.
    """

    min: float = -math.inf
    max: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    unit: str = ""

    def __contains__(self, value: float) -> bool:
        return self.min <= value <= self.max and self.above < value < self.below

    def __str__(self) -> str:
        low = f"above {_text(self.above)}" if self.above > -math.inf else _text(self.min)
        high = f"below {_text(self.below)}" if self.below < math.inf else _text(self.max)
        unit = f" {self.unit}" if self.unit else ""
        if math.isinf(max(self.min, self.above)) and math.isinf(min(self.max, self.below)):
            return f"any finite number of{unit}" if unit else "any finite number"
        if not math.isfinite(min(self.max, self.below)):
            is_open = self.above > -math.inf or self.min == -math.inf
            return (low if is_open else f"{low}{unit} or more") + (unit if is_open else "")
        return f"{low} to {high}{unit}"


def _text(limit: float) -> str:
    return f"{limit:.12g}" if float(limit).is_integer() else f"{limit:.6g}"


def check_fields(instance: Any, of: str = "") -> None:
    """Check that each field of numbers, or with a `Range` or a `Literal`, holds an allowed value.

    Call it in `__post_init__`. A field that may be None is not checked if it is; an infinite number
    is outside any open range. NumPy's values become Python's, so that files can hold them.

    Args:
        instance: The dataclass.
        of: Owner of the fields, for messages.

    Raises:
        InputError: If a value is not a number, not an integer or out of range; states the field and
            the allowed values.
        UnknownNameError: If a string is none of the literals.
    """
    owner = "" if not of else f"{of}' " if of.endswith("s") else f"{of}'s "
    plain_fields(instance)
    for name, limit in _limits(type(instance)):
        value = getattr(instance, name)
        if limit.words and not _are_numbers(value, limit):
            limits = f", {limit.range_}" if limit.range_ else ""
            raise InputError(f"{owner}{name} is {value!r}. Allowed: {limit.words}{limits}.")
        if limit.count is not None and value is not None:
            object.__setattr__(instance, name, plain_value(tuple(value)))
            continue
        if limit.range_ is not None and value is not None and value not in limit.range_:
            raise InputError(f"{owner}{name} is {value}. Allowed: {limit.range_}.")
        if limit.known and isinstance(value, str) and value not in limit.known:
            raise UnknownNameError(name.replace("_", " "), value, limit.known)
        if limit.whole and not (_is_number(value, limit) and value in limit.whole):
            allowed = ", ".join(map(str, limit.whole))
            raise InputError(f"{owner}{name} is {value!r}. Allowed: {allowed}.")


def plain_fields(instance: Any) -> None:
    """Convert the fields of a dataclass that are NumPy's scalars or short arrays to Python's."""
    for f in fields(instance):
        value = getattr(instance, f.name)
        plain = plain_value(value)
        if plain is not value:
            object.__setattr__(instance, f.name, plain)


def plain_value(value: Any) -> Any:
    """Convert a scalar of NumPy, or an array without axes, to Python's; also within tuples."""
    if isinstance(value, tuple):
        return _mapped(plain_value, value)
    is_numpy = type(value).__module__ == "numpy" and getattr(value, "ndim", 1) == 0
    return value.item() if is_numpy else value


def _mapped(function: Callable[[Any], Any], items: tuple[Any, ...]) -> tuple[Any, ...]:
    """Apply a function to the items of a tuple; return the tuple itself if none changes."""
    results = tuple(function(item) for item in items)
    return results if any(a is not b for a, b in zip(results, items, strict=True)) else items


@dataclass(frozen=True)
class _Limit:
    """Allowed values of a field.

    Attributes:
        is_optional: Whether it may be None.
        words: Description of the numbers that it holds; empty if it may hold anything else.
        is_whole: Whether they are whole.
        count: Their number in a tuple, 0 for any; None for a single number.
        range_: Range of a single number.
        known: Allowed strings; empty for any.
        whole: Allowed whole numbers of a `Literal`; empty for any.
    """

    is_optional: bool
    words: str
    is_whole: bool
    count: int | None
    range_: Range | None
    known: tuple[str, ...]
    whole: tuple[int, ...]


@cache
def _limits(cls: type) -> tuple[tuple[str, _Limit], ...]:
    hints = get_type_hints(cls, include_extras=True)
    limits = [(f.name, _limit(hints[f.name])) for f in fields(cls)]
    return tuple(
        (name, limit) for name, limit in limits if limit.words or limit.known or limit.whole
    )


def _limit(hint: Any) -> _Limit:
    """Allowed values of a type."""
    range_, plain = range_of(hint), get_args(hint)[0] if get_origin(hint) is Annotated else hint
    is_union = get_origin(plain) in (Union, UnionType)
    members = set(get_args(plain) if is_union else (plain,))
    is_optional = bool({None, NoneType, Any} & members)
    members -= {None, NoneType}
    count = None
    if len(members) == 1 and get_origin(items := next(iter(members))) is tuple:
        members = set(get_args(items)) - {...}
        count = 0 if ... in get_args(items) else len(get_args(items))
    is_whole, words = members == {int}, ""
    if range_ or (members and members <= {int, float}):
        whole = "whole " if is_whole else ""
        words = f"a {whole}number" if count is None else f"{count or ''} {whole}numbers".lstrip()
    known = _literals(hint)
    names = tuple(value for value in known if isinstance(value, str))
    # The literals of a union, such as 0 or a table, do not limit its other values.
    whole = () if is_union or names else known
    return _Limit(is_optional, words, is_whole or bool(whole), count, range_, names, whole)


def _are_numbers(value: Any, limit: _Limit) -> bool:
    if value is None:
        return limit.is_optional
    if limit.count is None:
        return _is_number(value, limit)
    if not hasattr(value, "__len__") or getattr(value, "ndim", 1) == 0:
        return False
    is_counted = limit.count in (0, len(value))
    return is_counted and all(_is_number(item, limit) for item in value)


def _is_number(value: Any, limit: _Limit) -> bool:
    value = plain_value(value)
    if not limit.is_whole:
        return isinstance(value, Real) or getattr(value, "ndim", 1) == 0
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def _literals(hint: Any) -> tuple[Any, ...]:
    """Literals that a type allows; empty if it allows any string."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if get_origin(hint) is Literal:
        return get_args(hint)
    members = get_args(hint)
    if str in members:
        return ()
    return next((get_args(m) for m in members if get_origin(m) is Literal), ())


def range_of(hint: Any) -> Range | None:
    """Range in the annotation of a type, if any."""
    return next((m for m in getattr(hint, "__metadata__", ()) if isinstance(m, Range)), None)


@dataclass(frozen=True)
class FileRef:
    """A file, or the folder of a texture, by its path and checksum.

    Attributes:
        path: Path relative to the working directory.
        sha256: Checksum of the file, or of a texture's head file; set when recorded, verified when
            given.
    """

    path: str
    sha256: str = ""

    def checked(self) -> FileRef:
        """Return the reference with the current checksum of the file.

        Raises:
            InputError: If the file cannot be read, or does not match the given checksum.
        """
        path = Path(self.path)
        try:
            actual = file_sha256(path / _TEXTURE_HEAD if path.is_dir() else path)
        except OSError as error:
            raise InputError(f"Cannot read {self.path}: {error.strerror}.") from error
        if self.sha256 and actual != self.sha256:
            raise InputError(
                f"{self.path} has sha256 {actual[:12]}…, but the scenario was made with "
                f"{self.sha256[:12]}…. Give the original file, or remove the sha256."
            )
        return replace(self, sha256=actual)


def file_ref(given: FileRef | str | Path) -> FileRef:
    """Convert a path to a reference; references are unchanged."""
    return given if isinstance(given, FileRef) else FileRef(str(given))


def path_of(given: FileRef | str | Path) -> Path:
    """Path of a file that is given as a reference or as a path."""
    return Path(given.path if isinstance(given, FileRef) else given)


def with_checksums(tree: Any) -> Any:
    """Add the checksum to all file references in a tree of dataclasses and tuples.

    Raises:
        InputError: If a file cannot be read or does not match its checksum.
    """
    if isinstance(tree, FileRef):
        return tree.checked()
    if isinstance(tree, tuple):
        return _mapped(with_checksums, tree)
    if not is_dataclass(tree) or isinstance(tree, type):
        return tree
    values = {f.name: getattr(tree, f.name) for f in fields(tree)}
    checked = {name: with_checksums(value) for name, value in values.items()}
    changed = {name: value for name, value in checked.items() if value is not values[name]}
    return replace(tree, **changed) if changed else tree
