"""Accepted settings of the motility of a segment, and the published values."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.tissue.motility.segment import PER_MINUTE, organ_divisions, segment_motilities

SEGMENTS = segment_motilities()


def test_a_slow_wave_runs_its_wavelength_in_its_period() -> None:
    ileum = SEGMENTS["ileum"]
    for speed, rate, length in zip(ileum.speeds, ileum.rates, ileum.wavelengths, strict=True):
        assert length == pytest.approx(speed / rate)


def test_rates_fall_from_the_duodenum_to_the_end_of_the_ileum() -> None:
    chain = [SEGMENTS[name].rates for name in ("duodenum", "jejunum", "ileum")]
    falling = [rate / PER_MINUTE for rates in chain for rate in rates]
    assert falling == sorted(falling, reverse=True)
    assert falling[0] == pytest.approx(12.0)
    assert 8.0 <= falling[-1] <= 9.0
    assert SEGMENTS["antrum"].rates[0] == pytest.approx(3.0 * PER_MINUTE)


def test_whole_organs_are_made_of_known_segments() -> None:
    for parts in organ_divisions().values():
        assert sum(fraction for _, fraction in parts) == pytest.approx(1.0)
        assert all(name in SEGMENTS for name, _ in parts)


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("amplitude", 1.2, "amplitude is 1.2. Allowed: 0 to 1"),
        ("activity", float("nan"), "activity is nan"),
        ("retrograde", -0.1, "retrograde is -0.1"),
        ("standing", 2.0, "standing is 2.0"),
        ("rates", (0.0, 0.2), "rates is .* two numbers above 0 1/s"),
        ("rates", (0.2,), "rates is .* two numbers"),
        ("speeds", (0.01, float("inf")), "speeds is .* two numbers above 0 m/s"),
        ("duration", 6.0, "duration is 6.0. Allowed: above 0 to below 5"),
        ("extent", 0.0, "extent is 0.0. Allowed: above 0 m"),
    ],
)
def test_rejects(field: str, value: object, match: str) -> None:
    with pytest.raises(InputError, match=match):
        replace(SEGMENTS["duodenum"], **{field: value})


def test_rejects_more_contractions_than_there_are() -> None:
    with pytest.raises(InputError, match=r"retrograde \+ standing is 1.2"):
        replace(SEGMENTS["duodenum"], retrograde=0.6, standing=0.6)


def test_rejects_an_unknown_zone() -> None:
    with pytest.raises(UnknownNameError, match=r"No zone named 'colon'. Known: duodenum"):
        replace(SEGMENTS["duodenum"], zone="colon")
