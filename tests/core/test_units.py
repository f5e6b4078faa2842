"""Units: factors to SI and the parsing of stated units."""

from __future__ import annotations

import math

import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, DEG, DM, LENGTH_UNITS, MM, UM, parse_length


def test_factors_are_si() -> None:
    assert (UM, MM, CM, DM) == (1e-6, 1e-3, 1e-2, 1e-1)
    assert math.isclose(180.0 * DEG, math.pi, rel_tol=1e-15)


@pytest.mark.parametrize("unit", LENGTH_UNITS)
@pytest.mark.parametrize("factor", ["", "1", "5", "2.5", "1e-2", "0.05 "])
def test_length_is_factor_times_unit(unit: str, factor: str) -> None:
    expected = float(factor or 1.0) * LENGTH_UNITS[unit]
    assert parse_length(f"{factor}{unit}") == pytest.approx(expected, rel=1e-15)


def test_spaces_do_not_matter() -> None:
    assert parse_length(" 5 cm ") == parse_length("5cm") == pytest.approx(0.05)


@pytest.mark.parametrize("text", ["", "5", "inch", "MM", "mm5", "5 cm cm", "millimeter"])
def test_unknown_unit_lists_the_allowed_ones(text: str) -> None:
    with pytest.raises(InputError, match=r"Unknown length unit .*Allowed: m, dm, cm, mm, um"):
        parse_length(text)


@pytest.mark.parametrize("text", ["0mm", "-1mm", "1e999m", "1e-mm", "--mm", ".mm"])
def test_factor_must_be_positive_and_finite(text: str) -> None:
    with pytest.raises(InputError, match="needs a positive number before its unit"):
        parse_length(text)
