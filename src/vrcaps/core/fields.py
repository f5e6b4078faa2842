"""Types of a dataclass's fields: checked values with limits, and files with checksums.

Limits are declared in the type and checked in the constructor; checksums let a recording be
repeated from the same data.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
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
    if isinstance(limit, int):
        return str(limit)
    return f"{limit:.12g}" if limit.is_integer() else f"{limit:.6g}"


def check_fields(instance: Any, of: str = "") -> None:
    """Check that each field of a dataclass holds a value of its type, within its `Range`, if any.

    Call it in `__post_init__`. Numbers, strings, booleans, literals, classes, tuples and unions of
    these are checked; an infinite number is outside any open range, and a boolean is no number.
    NumPy's values become Python's and lists tuples, so that files can hold them.

    Args:
        instance: The dataclass.
        of: Owner of the fields, for messages.

    Raises:
        InputError: If a value is of another type or out of range; states the field and the allowed
            values.
        UnknownNameError: If a string is none of the literals.
    """
    owner = "" if not of else f"{of}' " if of.endswith("s") else f"{of}'s "
    for name, kind in _kinds(type(instance)):
        given = getattr(instance, name)
        value = kind.converted(given)
        if value is not given:
            object.__setattr__(instance, name, value)
        if not kind.holds(value):
            if kind.names and isinstance(value, str):
                raise UnknownNameError(name.replace("_", " "), value, kind.names)
            given_text = " ".join(_repr(value).split())
            raise InputError(f"{owner}{name} is {given_text:.80}. Allowed: {kind.allowed}.")
        if kind.range_ and not kind.contains(value):
            allowed = kind.words if str(kind.range_) in kind.words else kind.range_
            raise InputError(f"{owner}{name} is {value}. Allowed: {allowed}.")


def _repr(value: Any) -> str:
    try:
        return repr(value)
    except ValueError:  # Python writes no integer of more than 4,300 digits
        return "an integer of thousands of digits"


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
    plain = value.item() if is_numpy else value
    # Fractions and NumPy's long double have no form in files.
    is_other = isinstance(plain, Real) and not isinstance(plain, int | float)
    return float(plain) if is_other else plain


def _mapped(function: Callable[[Any], Any], items: tuple[Any, ...]) -> tuple[Any, ...]:
    """Apply a function to the items of a tuple; return the tuple itself if none changes."""
    results = tuple(function(item) for item in items)
    return results if any(a is not b for a, b in zip(results, items, strict=True)) else items


@dataclass(frozen=True)
class _Kind:
    """Values of a type.

    Attributes:
        words: Their description; empty if any value is allowed.
        holds: Returns whether a value is one of them, apart from the range.
        range_: Range of a single number.
        names: The only strings among them; empty if there are none or any.
        is_sequence: Whether a tuple is one of them.
    """

    words: str = ""
    holds: Callable[[Any], bool] = lambda value: True
    range_: Range | None = None
    names: tuple[str, ...] = ()
    is_sequence: bool = False

    @property
    def allowed(self) -> str:
        """Their description with the range."""
        is_stated = self.range_ is None or str(self.range_) in self.words
        return self.words if is_stated else f"{self.words}, {self.range_}"

    def converted(self, value: Any) -> Any:
        """Convert a value of NumPy to Python's, and a list or an array to a tuple."""
        if self.is_sequence and _is_sequence(value) and not isinstance(value, tuple):
            return tuple(value.tolist() if hasattr(value, "tolist") else map(plain_value, value))
        return plain_value(value)

    def contains(self, value: Any) -> bool:
        """Return whether a value is one of them and within the range."""
        is_limited = self.range_ is not None and _is_number(value)
        return self.holds(value) and (not is_limited or value in self.range_)


@cache
def _kinds(cls: type) -> tuple[tuple[str, _Kind], ...]:
    hints = get_type_hints(cls, include_extras=True)
    return tuple((f.name, _kind(hints[f.name])) for f in fields(cls))


def _kind(hint: Any) -> _Kind:
    """Values of a type; any value for a type that cannot be checked, such as a protocol."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        inner = _kind(parts[0])
        return replace(inner, range_=range_of(hint) or inner.range_)
    if origin in (Union, UnionType):
        return _union([_kind(part) for part in parts if part is not NoneType], NoneType in parts)
    if origin is Literal:
        words = ", ".join(map(str, parts))
        names = tuple(part for part in parts if isinstance(part, str))
        return _Kind(
            words, lambda value: type(value) in map(type, parts) and value in parts, names=names
        )
    if origin is tuple:
        return _tuple(parts)
    if origin is Mapping:
        return _Kind("a mapping", lambda value: isinstance(value, Mapping))
    return _SCALARS.get(hint) or _instances(hint)


def _instances(cls: Any) -> _Kind:
    """Instances of a dataclass or a class of vrcaps; any value for protocols and other classes."""
    is_own = isinstance(cls, type) and (is_dataclass(cls) or cls.__module__.startswith("vrcaps"))
    if not is_own or getattr(cls, "_is_protocol", False):
        return _Kind()
    article = "an" if cls.__name__[0] in "AEIOU" else "a"
    return _Kind(f"{article} {cls.__name__}", lambda value: isinstance(value, cls))


def _union(kinds: list[_Kind], is_optional: bool) -> _Kind:
    """Values of any of several kinds, or None."""
    if not all(kind.words for kind in kinds):
        return _Kind()
    words = list(dict.fromkeys(kind.words for kind in kinds))
    if "a number" in words and "a whole number" in words:
        words.remove("a whole number")
    range_ = next((kind.range_ for kind in kinds if kind.range_), None)
    if range_ and len(words) > 1:
        limited = next(kind.words for kind in kinds if kind.range_)
        words = [*(one for one in words if one != limited), f"{limited}, {range_}"]
    is_text = any(kind.holds("") for kind in kinds)
    return _Kind(
        " or ".join(words),
        lambda value: (value is None and is_optional) or any(kind.holds(value) for kind in kinds),
        range_,
        () if is_text else tuple(name for kind in kinds for name in kind.names),
        any(kind.is_sequence for kind in kinds),
    )


def _tuple(parts: tuple[Any, ...]) -> _Kind:
    """Tuples of items."""
    is_any_length = parts[-1] is ...
    items = [_kind(part) for part in parts if part is not ...]
    texts = list(dict.fromkeys(kind.words for kind in items))
    words, limits = _PLURALS.get(texts[0], ""), items[0].range_
    if not words and isinstance(parts[0], type) and texts[0]:
        words = f"{parts[0].__name__} objects"
    if len(texts) > 1 or not words:
        words = f"a tuple of {', '.join(text or 'any value' for text in texts)}"
    elif not is_any_length:
        words = f"{len(items)} {words}"

    def holds(value: Any) -> bool:
        if not _is_sequence(value) or not (is_any_length or len(value) == len(items)):
            return False
        own = items * len(value) if is_any_length else items
        return all(kind.contains(item) for kind, item in zip(own, value, strict=True))

    return _Kind(f"{words}, {limits}" if limits else words, holds, is_sequence=True)


def _is_sequence(value: Any) -> bool:
    return isinstance(value, list | tuple) or getattr(value, "ndim", 0) > 0


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not (isinstance(value, Real) or getattr(value, "ndim", 1) == 0):
        return False
    try:
        float(value)
    except (ArithmeticError, ValueError):
        return False
    return True


def _is_whole(value: Any) -> bool:
    try:
        operator.index(value)
    except TypeError:
        return False
    return _is_number(value)  # larger ones have no float


_SCALARS = {
    float: _Kind("a number", _is_number),
    int: _Kind("a whole number", _is_whole),
    bool: _Kind("True or False", lambda value: isinstance(value, bool)),
    str: _Kind("a string", lambda value: isinstance(value, str)),
    Path: _Kind("a path", lambda value: isinstance(value, Path)),
    NoneType: _Kind("None", lambda value: value is None),
}
_PLURALS = {"a number": "numbers", "a whole number": "whole numbers", "a string": "strings"}


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
        if path.is_dir() and not (path / _TEXTURE_HEAD).is_file():
            raise InputError(
                f"{self.path} is a folder. Allowed: a file, or a texture's folder with "
                f"{_TEXTURE_HEAD}."
            )
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
