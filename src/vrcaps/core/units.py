"""Unit factors to SI, and parsing of stated units without guessing.

Multiply to convert to SI (``5.5 * MM``), divide to convert from it (``length / MM``).
"""

from __future__ import annotations

import math
import re

from vrcaps.core.errors import InputError

UM = 1e-6
MM = 1e-3
CM = 1e-2
DM = 1e-1
DEG = math.pi / 180.0

LENGTH_UNITS = {"m": 1.0, "dm": DM, "cm": CM, "mm": MM, "um": UM}

_LENGTH = re.compile(r"\s*([0-9.eE+-]*)\s*([a-z]+)\s*")


def parse_length(text: str) -> float:
    """Length in meters of a stated unit or length, such as ``mm``, ``5cm`` or ``2 mm``.

    Args:
        text: A unit of `LENGTH_UNITS`, with an optional positive factor before it.

    Raises:
        InputError: If the unit is unknown or the factor is not a positive finite number.
    """
    match = _LENGTH.fullmatch(text)
    if match is None or match[2] not in LENGTH_UNITS:
        allowed = ", ".join(LENGTH_UNITS)
        raise InputError(f"Unknown length unit {text!r}. Allowed: {allowed}, or e.g. '5cm'.")
    try:
        factor = float(match[1]) if match[1] else 1.0
    except ValueError:
        factor = math.nan
    if not (math.isfinite(factor) and factor > 0.0):
        raise InputError(f"Length {text!r} needs a positive number before its unit, e.g. '5cm'.")
    return factor * LENGTH_UNITS[match[2]]
