"""An organ taken apart into arrays and plain values, as files hold it, and put together again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from vrcaps.organ.surface import Appearance, Centerline, OrganSurface


def organ_to_arrays(organ: OrganSurface) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """An organ's arrays and its plain values, each under ``field`` or ``part.field``."""
    arrays: dict[str, np.ndarray] = {}
    plain: dict[str, Any] = {}
    for prefix, part in (
        ("", organ),
        ("centerline.", organ.centerline),
        ("appearance.", organ.appearance),
    ):
        for field in fields(part) if part is not None else ():
            value = getattr(part, field.name)
            if isinstance(value, np.ndarray):
                arrays[prefix + field.name] = value
            elif field.name not in ("centerline", "appearance"):
                plain[prefix + field.name] = value
    return arrays, plain


def organ_from_arrays(values: Mapping[str, Any]) -> OrganSurface:
    """The organ whose arrays and plain values `organ_to_arrays` named.

    Raises:
        KeyError, TypeError: If a value is missing or unknown.
    """
    parts: dict[str, dict[str, Any]] = {"": {}, "centerline": {}, "appearance": {}}
    for name, value in values.items():
        part, _, field = name.rpartition(".")
        parts[part][field] = value
    organ = parts[""]
    organ["label_names"] = tuple(organ["label_names"])
    appearance = Appearance(**parts["appearance"]) if parts["appearance"] else None
    return OrganSurface(
        **organ, centerline=Centerline(**parts["centerline"]), appearance=appearance
    )


def organ_sha256(organ: OrganSurface) -> str:
    """SHA-256 checksum of all that an organ is, in hexadecimal: alike for equal organs only."""
    arrays, plain = organ_to_arrays(organ)
    types = {name: (array.dtype.str, array.shape) for name, array in sorted(arrays.items())}
    text = json.dumps([types, json_safe(plain)], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for name in types:
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def json_safe(value: Any) -> Any:
    """A value as JSON can hold it: arrays as lists, other objects as text."""
    if isinstance(value, dict):
        return {str(k): json_safe(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return json_safe(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if isinstance(value, bool | int | float | str | None) else str(value)
