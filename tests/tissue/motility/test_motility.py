"""Accepted settings of motility as a whole."""

from __future__ import annotations

import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.tissue.motility.motility import GiantContractions, Motility


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("rate", 1.0, "rate is 1.0. Allowed: 0 to 1 per hour"),
        ("amplitude", -1.0, "amplitude is -1.0"),
        ("origin", 2.0, "origin is 2.0"),
        ("speed", 0.0, "speed is 0.0. Allowed: above 0"),
        ("duration", float("nan"), "duration is nan"),
        ("extent", -1.0, "extent is -1.0"),
        ("extent", 100.0, "below 3600 s"),
    ],
)
def test_giant_contractions_reject(field: str, value: float, match: str) -> None:
    with pytest.raises(InputError, match=match):
        GiantContractions(**{field: value})


@pytest.mark.parametrize("least", [0.0, 1.5, float("nan")])
def test_rejects_a_closed_lumen(least: float) -> None:
    with pytest.raises(InputError, match=r"min_lumen_scale is .* Allowed: above 0 to 1"):
        Motility(min_lumen_scale=least)


def test_rejects_an_unknown_stand_in() -> None:
    with pytest.raises(UnknownNameError, match=r"No segment named 'gut'. Known: antrum"):
        Motility(fallback_segment="gut")


@pytest.mark.parametrize("front", [-0.1, float("nan")])
def test_rejects_a_front_nowhere(front: float) -> None:
    with pytest.raises(InputError, match=r"front is .* Allowed: 0 m or more, with a complex"):
        Motility(front=front)


def test_rejects_a_front_without_the_complex() -> None:
    with pytest.raises(InputError, match=r"front is 0.5. Allowed: 0 m or more, with a complex"):
        Motility(front=0.5, complex=None)
