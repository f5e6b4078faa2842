"""Numbers in TOML: exact conversion, shortest text."""

import math
import tomllib
from decimal import Decimal

import numpy as np
import pytest

from vrcaps.errors import InputError
from vrcaps.toml_table import DEGREE, MILLI, decimal_text, plain, to_float, toml_text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0054, MILLI, "5.4"),
        (0.0245, MILLI, "24.5"),
        (0.0, MILLI, "0"),
        (-0.00065, MILLI, "-0.65"),
        (math.radians(85.0), DEGREE, "85"),
        (math.pi, DEGREE, "180"),
    ],
)
def test_shortest_text(value, unit, text):
    assert decimal_text(value, unit) == text


def test_every_float_survives_text_in_any_unit():
    rng = np.random.default_rng(0)
    values = rng.normal(size=300) * 10.0 ** rng.integers(-12, 12, 300)
    for value in [*values.tolist(), 5e-324, 1.7e308, 0.1 + 0.2]:
        for unit in (MILLI, DEGREE):
            text = decimal_text(value, unit)
            assert to_float(plain_decimal(text), unit) == value


def plain_decimal(text: str):

    return tomllib.loads(f"x = {text}", parse_float=Decimal)["x"]


def test_toml_text_reads_back():

    value = {"a b": [1, 2.5, True, 'say "µ"\n\x7f'], "c": {"d": -0.0}}
    text = f"x = {toml_text(value)}"
    assert plain(tomllib.loads(text, parse_float=Decimal)["x"]) == value


def test_toml_text_refuses_other_types():
    with pytest.raises(InputError, match=r"Cannot write None as TOML\. Allowed: strings"):
        toml_text(None)
