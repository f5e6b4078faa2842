"""Conversion between organs and the arrays and plain values that files store."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from vrcaps.organ.surface import Appearance, Centerline, OrganSurface


def organ_to_arrays(organ: OrganSurface) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and plain values of an organ, under ``field`` or ``part.field``."""
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
    """Reconstruct an organ from the arrays and plain values of `organ_to_arrays`.

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
    """SHA-256 checksum of an organ's contents, in hexadecimal; the same only for equal organs."""
    arrays, plain = organ_to_arrays(organ)
    types = {name: (array.dtype.str, array.shape) for name, array in sorted(arrays.items())}
    text = json.dumps([types, json_safe(plain)], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for name in types:
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def json_safe(value: Any) -> Any:
    """Convert a value to JSON types: arrays to lists, other objects to text."""
    if isinstance(value, dict):
        return {str(k): json_safe(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return json_safe(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if isinstance(value, bool | int | float | str | None) else str(value)
