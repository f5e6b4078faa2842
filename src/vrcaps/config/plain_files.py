"""Files of plain values (TOML and JSON), folders of them, and exact conversion of units to SI.

TOML and JSON are read with exact decimals and written atomically. The YAML front matter of Markdown
cards has the keys that the Hugging Face Hub reads, see
https://huggingface.co/docs/hub/model-cards and https://huggingface.co/docs/hub/datasets-cards.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, fields
from decimal import Context, Decimal
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed

_LONGEST = 2**28
"""Maximum number of characters of a file: a device such as /dev/zero has no end."""
_BITS = 64
"""Integers have fewer bits: seeds are the largest."""
_DEEPEST = 64
"""Maximum depth of nested tables and lists."""


def stored_fields(cls: Any) -> list[Field]:
    """Fields of a dataclass, or of its instance, that files contain.

    A field with ``metadata={"stored": False}``, such as a pose in the world, is left out.
    """
    return [f for f in fields(cls) if f.metadata.get("stored", True)]


def read_plain(path: Path, noun: str) -> Any:
    """Read a TOML file, or a JSON file if the name does not end in `.toml`.

    Args:
        path: The file.
        noun: Kind of its contents, for messages, such as ``scenario``.

    Raises:
        InputError: If the file cannot be read or is neither.
    """
    kind = "TOML" if path.suffix == ".toml" else "JSON"
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
        if len(text) > _LONGEST:
            raise ValueError(f"it has more than {_LONGEST} characters")
        plain = tomllib.loads(text, parse_float=Decimal) if kind == "TOML" else json.loads(text)
        require_bounded(plain)
        return plain
    except OSError as error:
        raise InputError(f"Cannot read the {noun} file {path}: {error.strerror}.") from error
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise InputError(f"The {noun} file {path} is not {kind}: {error}.") from error


def require_bounded(plain: Any) -> None:
    """Check that plain values have sizes that any part of the package can handle.

    Args:
        plain: Value of TOML or JSON.

    Raises:
        ValueError: If an integer has more than 64 bits, tables or lists are nested more than 64
            deep, or a text contains half of a surrogate pair.
    """
    level = [plain]
    for _ in range(_DEEPEST):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, Mapping):
                inner += [*value, *value.values()]
            elif isinstance(value, list | tuple):
                inner += value
            elif isinstance(value, int) and value.bit_length() > _BITS:
                raise ValueError(f"it contains an integer of more than {_BITS} bits")
            elif isinstance(value, str) and not value.isascii():
                value.encode()  # raises UnicodeEncodeError, a ValueError
        if not inner:
            return
        level = inner
    raise ValueError(f"its tables or lists are nested more than {_DEEPEST} deep")


@dataclass(frozen=True)
class CatalogFolder:
    """A folder of TOML files; the stem of each file is a name.

    Attributes:
        path: The folder.
        kind: Kind of object that a file describes, for error messages.
    """

    path: Path
    kind: str

    def names(self) -> tuple[str, ...]:
        """Names of the catalog, sorted."""
        return tuple(path.stem for path in listed(self.path, "*.toml"))

    def find(self, name_or_path: str | Path) -> Path:
        """Return the catalog file with a name, or a user's file by its path.

        Raises:
            UnknownNameError: If the catalog has no such name.
            InputError: If there is no file at the path.
        """
        path = Path(name_or_path)
        if path.suffix == ".toml" or len(path.parts) > 1:
            if not path.is_file():
                known = ", ".join(self.names())
                raise InputError(
                    f"No {self.kind} file at {path}. Give a TOML file, or one of: {known}."
                )
            return path
        if str(name_or_path) not in self.names():
            raise UnknownNameError(self.kind, str(name_or_path), self.names())
        return self.path / f"{name_or_path}.toml"


def decode_json(data: bytes | str, what: object) -> Any:
    """Decode a JSON text.

    Args:
        data: The text, UTF-8 if given as bytes.
        what: Source of the text, for messages.

    Raises:
        InputError: If it is not JSON.
    """
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{what} is not JSON: {error}.") from error


def write_toml(path: Path, plain: dict[str, Any], noun: str) -> None:
    """Write plain values as TOML atomically.

    Args:
        path: The file.
        plain: Its tables; numbers may be decimals.
        noun: Kind of its contents, for messages.

    Raises:
        InputError: If a value has no TOML form or the file cannot be written.
    """
    import tomli_w

    try:
        write_bytes(path, tomli_w.dumps(plain).encode())
    except TypeError as error:
        raise InputError(f"Cannot write the {noun} file {path} as TOML: {error}.") from error
    except OSError as error:
        raise InputError(f"Cannot write the {noun} file {path}: {error.strerror}.") from error


UNITS = {
    "mm": Decimal("1e-3"),
    "g": Decimal("1e-3"),
    "mw_per_sr": Decimal("1e-3"),
    "deg": Decimal("0.01745329251994329576923690768488612713"),
}
"""SI value of each non-SI unit; a degree is π/180 to 37 digits."""

_CONTEXT = Context(prec=40)


def to_si(value: float | Decimal, unit: str = "") -> float:
    """SI value of a quantity in a unit, rounded once."""
    exact = value if isinstance(value, int | Decimal) else repr(value)
    return float(_CONTEXT.multiply(Decimal(exact), UNITS.get(unit, Decimal(1))))


def from_si(value: float, unit: str = "") -> Decimal:
    """Shortest decimal value in a unit that `to_si` converts back to `value`."""
    quotient = _CONTEXT.divide(Decimal(float(value)), UNITS.get(unit, Decimal(1)))
    candidates = (quotient.normalize(Context(prec=digits)) for digits in range(1, 40))
    shortest = next((c for c in candidates if to_si(c, unit) == value), quotient)
    return Decimal(f"{shortest:f}") if -6 <= shortest.adjusted() <= 15 else shortest


def as_floats(value: Any) -> Any:
    """Convert the decimals in a file's value to floats."""
    if isinstance(value, Decimal):
        return float(value)
    if isinstance(value, list):
        return [as_floats(item) for item in value]
    if isinstance(value, Mapping):
        return {key: as_floats(item) for key, item in value.items()}
    return value


_PLAIN = re.compile(r"[A-Za-z][\w./<-]*")
_RESERVED = {"true", "false", "yes", "no", "on", "off", "y", "n", "null"}
"""Words that YAML 1.1 reads as a boolean or as null, in lower case."""
_SIZES = (
    *((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M")),
    *((10**7, "1M<n<10M"), (10**8, "10M<n<100M"), (10**9, "100M<n<1B"), (10**10, "1B<n<10B")),
)
_MAX_SIZE = "10B<n<100B"


def front_matter(values: Mapping[str, Any]) -> str:
    """Return values as a YAML block with its delimiters; keys with empty values are left out.

    Args:
        values: Strings, numbers, booleans, and mappings and sequences of them.

    Example:
        >>> print(front_matter({"license": "mit", "tags": ["a", "1"], "datasets": []}), end="")
        ---
        license: mit
        tags:
        - a
        - "1"
        ---
    """
    return "\n".join(["---", *_lines(values), "---", ""])


def size_category(frames: int) -> str:
    """Size category of the Hub for a number of frames."""
    return next((name for limit, name in _SIZES if frames < limit), _MAX_SIZE)


def _lines(values: Mapping[str, Any]) -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield f"{key}:"
            yield from (f"  {line}" for line in _lines(value))
        elif _is_list(value) and value:
            yield f"{key}:"
            yield from (line for item in value for line in _item(item))
        elif not (_is_list(value) or value in ("", None) or isinstance(value, Mapping)):
            yield f"{key}: {_scalar(value)}"


def _item(value: Any) -> Iterator[str]:
    """Lines of an item of a list."""
    lines = list(_lines(value)) if isinstance(value, Mapping) else [_scalar(value)]
    yield f"- {lines[0]}"
    yield from (f"  {line}" for line in lines[1:])


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _scalar(value: object) -> str:
    if isinstance(value, float):
        text = repr(value)  # YAML 1.1 reads 1e-05 as text, 1.0e-05 as a number
        return text if "." in text else text.replace("e", ".0e")
    if isinstance(value, str) and _PLAIN.fullmatch(value) and value.lower() not in _RESERVED:
        return value
    return json.dumps(value, ensure_ascii=False)
