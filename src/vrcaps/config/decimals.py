"""Exact conversion between decimal values with units, as in files, and SI floats."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Context, Decimal
from typing import Any

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
