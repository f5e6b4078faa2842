"""YAML calibration files."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, import_extra


def read_yaml(path: Path) -> dict[str, Any]:
    """Read the table in a YAML file.

    Raises:
        InputError: If the file cannot be read or does not hold a table.
        MissingExtraError: If PyYAML is not installed.
    """
    yaml = import_extra("yaml", "formats", package="PyYAML")
    try:
        plain = yaml.safe_load(path.read_text("utf-8-sig"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"Cannot read {path}: {' '.join(str(error).split())}.") from error
    if not isinstance(plain, dict):
        raise InputError(f"{path} holds no table of keys and values.")
    return plain


def numbers_of(plain: Any, key: str, count: int, path: Path) -> list[float]:
    """Numbers of a key.

    Args:
        plain: Table with the key.
        key: Key of a list of numbers.
        count: Required number of values.
        path: Path of the file, for messages.

    Raises:
        InputError: If they are missing.
    """
    found = plain.get(key) if isinstance(plain, dict) else None
    try:
        numbers = [float(value) for value in found]  # type: ignore[union-attr]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count:
        shown = reprlib.repr(found)[:80]
        raise InputError(f"{path} has for {key} {shown}. Allowed: {count} numbers.")
    return numbers


def yaml_list(values: Iterable[float]) -> str:
    """Format numbers as a list; YAML reads ``1e-05`` as text, ``1.0e-05`` as a number."""
    texts = (repr(float(value)) for value in values)
    fixed = (t.replace("e", ".0e") if "e" in t and "." not in t else t for t in texts)
    return f"[{', '.join(fixed)}]"
