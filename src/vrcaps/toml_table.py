"""Strict reading of one TOML table: each key is asked for once, what is left over is an error.

Numbers are read as decimals and converted to SI exactly, so that a value written by
`decimal_text` reads back as the same float.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, field
from decimal import Context, Decimal
from pathlib import Path
from typing import Any

from vrcaps.errors import InputError

ONE = Decimal(1)
MILLI = Decimal("1e-3")
DEGREE = Decimal("0.01745329251994329576923690768488612713")
"""π/180 to 37 digits."""

_CONTEXT = Context(prec=40)
_LARGEST = Decimal("1e300")


@dataclass
class TomlTable:
    """A table being read.

    Attributes:
        entries: What the file holds; numbers are int or Decimal.
        where: File and table, the start of each error message.
    """

    entries: dict[str, Any]
    where: str
    _known: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path, kind: str) -> TomlTable:
        """The table of a whole file; `kind` says in a word what the file describes.

        Raises:
            InputError: If the file cannot be read or is no TOML.
        """
        try:
            entries = tomllib.loads(path.read_text(encoding="utf-8"), parse_float=Decimal)
        except OSError as error:
            raise InputError(f"Cannot read the {kind} file {path}: {error.strerror}.") from error
        except (UnicodeDecodeError, tomllib.TOMLDecodeError, ArithmeticError) as error:
            raise InputError(f"The {kind} file {path} is not TOML: {error}.") from error
        return cls(entries, path.name)

    def take(self, key: str, allowed: str) -> Any:
        """Value of a key that must be there; `allowed` says in words what it is."""
        self._known.append(key)
        if key not in self.entries:
            given = ", ".join(self.entries) or "nothing"
            raise InputError(f"{self.where}: {key!r} is missing ({allowed}). Given: {given}.")
        return self.entries[key]

    def has(self, key: str) -> bool:
        """Whether an optional key is there."""
        self._known.append(key)
        return key in self.entries

    def text(self, key: str) -> str:
        """A string."""
        value = self.take(key, "a string")
        return value if isinstance(value, str) else self.fail(key, value, "a string")

    def integer(self, key: str, most: int) -> int:
        """A whole number from 1 to `most`."""
        allowed = f"a whole number from 1 to {most}"
        value = self.take(key, allowed)
        whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most
        return value if whole else self.fail(key, value, allowed)

    def number(self, key: str, unit: Decimal = ONE, *, above: float | None = None) -> float:
        """A finite number times `unit`, above a limit if one is given."""
        allowed = "a number" if above is None else f"a number above {above:g}"
        value = self.take(key, allowed)
        if not _is_number(value) or (above is not None and not value > above):
            return self.fail(key, value, allowed)
        return to_float(value, unit)

    def numbers(self, key: str, count: int | None = None, unit: Decimal = ONE) -> tuple[float, ...]:
        """A list of finite numbers, `count` of them or at least one, times `unit`."""
        allowed = f"a list of {count or 'one or more'} numbers"
        value = self.take(key, allowed)
        numeric = isinstance(value, list) and value and all(map(_is_number, value))
        if not numeric or (count is not None and len(value) != count):
            return self.fail(key, value, allowed)
        return tuple(to_float(item, unit) for item in value)

    def table(self, key: str) -> TomlTable:
        """A table within this one."""
        value = self.take(key, "a table")
        if not isinstance(value, dict):
            return self.fail(key, value, "a table")
        return TomlTable(value, f"{self.where}, {key}")

    def tables(self, key: str) -> list[TomlTable]:
        """A list of tables, at least one."""
        value = self.take(key, f"one or more [[{key}]] tables")
        if not (isinstance(value, list) and value and all(isinstance(v, dict) for v in value)):
            return self.fail(key, value, f"one or more [[{key}]] tables")
        return [TomlTable(item, f"{self.where}, {key} {i}") for i, item in enumerate(value)]

    def finish(self) -> None:
        """Check that no key is left over.

        Raises:
            InputError: If a key was not asked for.
        """
        extra = [key for key in self.entries if key not in self._known]
        if extra:
            allowed = ", ".join(self._known)
            raise InputError(f"{self.where}: unknown key {extra[0]!r}. Allowed: {allowed}.")

    def fail(self, key: str, value: Any, allowed: str) -> Any:
        """Raise the error that a key's value is not allowed.

        Raises:
            InputError: Always.
        """
        raise InputError(f"{self.where}: {key} = {_shown(value)}. Allowed: {allowed}.")


def to_float(value: int | Decimal, unit: Decimal) -> float:
    """A decimal number times a unit, rounded once."""
    return float(_CONTEXT.multiply(Decimal(value), unit))


def plain(value: Any) -> Any:
    """A TOML value with decimals as floats."""
    if isinstance(value, Decimal):
        return float(value)
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return value


def decimal_text(value: float, unit: Decimal = ONE) -> str:
    """Shortest decimal number that `to_float` turns back into `value`, given the same unit."""
    exact = _CONTEXT.divide(Decimal(float(value)), unit)
    candidates = (exact.normalize(Context(prec=digits)) for digits in range(1, 40))
    rounded = next((c for c in candidates if to_float(c, unit) == value), exact)
    return f"{rounded:f}" if -6 <= rounded.adjusted() <= 15 else f"{rounded:e}"


def toml_text(value: Any) -> str:
    """A string, number, truth value, list or table as TOML on one line.

    Raises:
        InputError: If the value is of another type.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_text, value))}]"
    if isinstance(value, dict):
        pairs = (f"{toml_text(str(key))} = {toml_text(item)}" for key, item in value.items())
        return f"{{{', '.join(pairs)}}}"
    raise InputError(
        f"Cannot write {value!r} as TOML. Allowed: strings, numbers, booleans, lists, tables."
    )


def _is_number(value: Any) -> bool:
    number = isinstance(value, (int, Decimal)) and not isinstance(value, bool)
    return number and Decimal(value).is_finite() and abs(value) < _LARGEST


def _shown(value: Any) -> str:
    text = toml_text(plain(value)) if isinstance(value, (int, Decimal, str, list)) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
