"""Decimal numbers of a unit: exact conversion to SI, shortest decimal back."""

import math
from decimal import Decimal

import numpy as np
import pytest

from vrcaps.config.decimals import as_floats, from_si, to_si


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0054, "mm", "5.4"),
        (0.0245, "mm", "24.5"),
        (0.0, "mm", "0"),
        (-0.00065, "mm", "-0.65"),
        (math.radians(85.0), "deg", "85"),
        (math.pi, "deg", "180"),
        (0.25, "", "0.25"),
    ],
)
def test_shortest_decimal(value, unit, text):
    assert str(from_si(value, unit)) == text
    assert to_si(Decimal(text), unit) == value


def test_every_float_survives_any_unit():
    rng = np.random.default_rng(0)
    values = rng.normal(size=300) * 10.0 ** rng.integers(-12, 12, 300)
    for value in [*values.tolist(), 5e-324, 1.7e308, 0.1 + 0.2]:
        for unit in ("mm", "deg", "px"):
            assert to_si(Decimal(str(from_si(value, unit))), unit) == value


def test_floats_and_whole_numbers_are_units_too():
    assert to_si(5.4, "mm") == 0.0054
    assert to_si(85, "deg") == math.radians(85.0)


def test_decimals_within_lists_and_tables():
    assert as_floats({"a": [Decimal("0.1"), 2], "b": "x"}) == {"a": [0.1, 2], "b": "x"}
