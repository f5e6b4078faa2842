"""Files of plain values: TOML and JSON, read with exact decimals, written atomically."""

from __future__ import annotations

import json
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes

_LONGEST = 2**28
"""Maximum number of characters of a file: a device such as /dev/zero has no end."""


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
        if kind == "TOML":
            return tomllib.loads(text, parse_float=Decimal)
        return json.loads(text)
    except OSError as error:
        raise InputError(f"Cannot read the {noun} file {path}: {error.strerror}.") from error
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise InputError(f"The {noun} file {path} is not {kind}: {error}.") from error


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
