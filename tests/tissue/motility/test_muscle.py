"""Contractions measured along an organ against what was commanded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import CM
from vrcaps.tissue.motility.migrating_complex import Front
from vrcaps.tissue.motility.motility import GiantContractions, Motility
from vrcaps.tissue.motility.muscle import Muscle, uniform
from vrcaps.tissue.motility.segment import PER_MINUTE, SegmentMotility, segment_motilities

STEADY = SegmentMotility(
    amplitude=0.6,
    rates=(0.2, 0.2),
    speeds=(1.5 * CM, 1.5 * CM),
    duration=2.0,
    extent=6.0 * CM,
    activity=1.0,
)


def muscle_of(segment: SegmentMotility, length: float = 0.5, seed: int = 0, **kw: object) -> Muscle:
    motility = Motility(segments={"gut": segment}, complex=None, giant=None, **kw)
    return Muscle(straight_gut({"gut": length}), motility, np.random.default_rng(seed))


def contractions(lumen_scale: np.ndarray, below: float = 0.8) -> int:
    """Number of times that the lumen becomes narrower than a fraction of its radius."""
    return int(np.sum((lumen_scale[1:] < below) & (lumen_scale[:-1] >= below)))


@pytest.mark.parametrize("back", [0.0, 1.0])
def test_a_full_wave_is_the_commanded_one(back: float) -> None:
    """1 − A cos²(π φ / (f d)) with φ = f t ∓ f s / c − θ, at every place and time."""
    muscle = muscle_of(replace(STEADY, retrograde=back))
    place = muscle.layout.arc_length
    middle = (place > 0.05) & (place < 0.45)
    turn = None
    sign = -1.0 if back else 1.0
    for time in (3.0, 47.3, 1000.1):
        lumen_scale = muscle.lumen_scale(time)
        phase = 0.2 * (time - sign * place / (1.5 * CM))
        if turn is None:  # θ is the patient's own: where the wave is at the first time
            turn = phase[np.argmin(np.where(middle, lumen_scale, 1.0))]
        away = phase - turn - np.rint(phase - turn)
        pulse = np.cos(np.pi * np.clip(away / 0.4, -0.5, 0.5)) ** 2
        # A station is 1 mm long: the wave's place is known to half of it.
        np.testing.assert_allclose(lumen_scale[middle], 1.0 - 0.6 * pulse[middle], atol=0.05)


def test_standing_contractions_do_not_run() -> None:
    muscle = muscle_of(replace(STEADY, standing=1.0))
    narrow = [muscle.lumen_scale(t)[50:450] for t in np.arange(0.0, 10.0, 0.1)]
    assert all(
        np.ptp(lumen_scale) < 1e-12 for lumen_scale in narrow
    )  # all at once, when all contract
    assert min(lumen_scale.min() for lumen_scale in narrow) == pytest.approx(0.4, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"activity": 0.3},
        {"activity": 0.3, "retrograde": 0.4, "standing": 0.3},
        {"activity": 0.8, "retrograde": 0.5},
    ],
)
def test_share_of_slow_waves_that_contract(changes: dict[str, float]) -> None:
    muscle = muscle_of(replace(STEADY, **changes), length=0.3)
    minutes = 30
    time = np.arange(0.0, minutes * 60.0, 0.5)
    lumen_scale = np.array([muscle.lumen_scale(t, slice(50, 226))[::25] for t in time])
    count = np.mean([contractions(column, below=0.7) for column in lumen_scale.T]) / minutes
    # A wave that contracts at one node only is below half strength up to the middle between two.
    assert count == pytest.approx(12.0 * changes["activity"], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["antrum", "duodenum", "jejunum", "ileum"])
@pytest.mark.parametrize("end", [0, 1])
def test_rate_of_segments_when_all_slow_waves_contract(name: str, end: int) -> None:
    segment = segment_motilities()[name]
    rate, speed = segment.rates[end], segment.speeds[end]
    steady = replace(
        segment, rates=(rate,) * 2, speeds=(speed,) * 2, activity=1.0, retrograde=0.0, standing=0.0
    )
    motility = Motility(segments={name: steady}, complex=None, giant=None)
    muscle = Muscle(straight_gut({name: 0.3}), motility, np.random.default_rng(0))
    place = slice(150, 151)
    lumen_scale = np.array([muscle.lumen_scale(t, place)[0] for t in np.arange(0.0, 600.0, 0.5)])
    assert contractions(lumen_scale, 0.7) / 10.0 == pytest.approx(rate / PER_MINUTE, abs=0.1)


def test_lumen_scale_is_a_function_of_time_alone() -> None:
    one, other = muscle_of(replace(STEADY, activity=0.4)), muscle_of(replace(STEADY, activity=0.4))
    for time in (5.0, 1.0, 77.7):
        one.lumen_scale(time)
    np.testing.assert_array_equal(one.lumen_scale(12.34), other.lumen_scale(12.34))
    np.testing.assert_array_equal(
        one.lumen_scale(12.34, slice(100, 180)), one.lumen_scale(12.34)[100:180]
    )
    different = muscle_of(replace(STEADY, activity=0.4), seed=1)
    assert not np.array_equal(one.lumen_scale(12.34), different.lumen_scale(12.34))


def test_lumen_scale_is_continuous() -> None:
    """No jump along the gut or in time: steps shrink with the interval."""
    organ = straight_gut({"antrum": 0.12, "duodenum": 0.2, "jejunum": 0.6, "ileum": 0.6})
    muscle = Muscle(organ, Motility(front=0.5), np.random.default_rng(3))
    for time in np.arange(-100.0, 500.0, 7.0):
        fine = muscle.lumen_scale(time + 1e-4) - muscle.lumen_scale(time)
        assert np.abs(fine).max() < 1e-4 * 5.0
        assert np.abs(np.diff(muscle.lumen_scale(time))).max() < 0.35  # over 1 mm


def test_rate_is_the_derivative() -> None:
    muscle = muscle_of(STEADY)
    time, step = np.linspace(20.0, 21.0, 101), 0.01
    rates = np.array([muscle.rate(t) for t in time])
    change = ((rates[1:] + rates[:-1]) / 2.0 * step).sum(axis=0)
    np.testing.assert_allclose(
        change, muscle.lumen_scale(21.0) - muscle.lumen_scale(20.0), atol=1e-3
    )


def test_never_closes() -> None:
    muscle = muscle_of(replace(STEADY, amplitude=1.0), min_lumen_scale=0.15)
    least = min(muscle.lumen_scale(t).min() for t in np.arange(0.0, 5.0, 0.05))
    assert least == 0.15


def test_no_contraction_in_the_first_phase() -> None:
    muscle = Muscle(straight_gut({"jejunum": 0.6}), Motility(front=0.3), np.random.default_rng(5))
    assert muscle.phase(np.array([0.3]), 1.0)[0] == 3
    place = muscle.layout.arc_length
    seen = set()
    for time in np.arange(0.0, 3 * 3600.0, 97.0):
        phase = muscle.phase(place, time)
        seen |= set(phase)
        inner = np.convolve(phase != 1, np.ones(161), "same") == 0  # 8 cm from any other phase
        assert (muscle.lumen_scale(time)[inner] == 1.0).all()
    assert {1, 2, 3} <= seen


@pytest.mark.slow
def test_giant_contractions_sweep_the_colon() -> None:
    """As many as commanded; each runs its extent at its speed."""
    giant = GiantContractions(rate=1.0 / 3600.0)
    quiet = replace(segment_motilities()["colon"], activity=0.0)
    motility = Motility(segments={"colon": quiet}, giant=giant)
    muscle = Muscle(straight_gut({"colon": 1.0}, edge=5e-3), motility, np.random.default_rng(1))

    def depth_at(times: np.ndarray) -> np.ndarray:
        return np.array([1.0 - muscle.lumen_scale(t) for t in times])

    times = np.arange(0.0, 8 * 3600.0, 10.0)  # a wave takes half a minute
    under_way = depth_at(times).max(axis=1) > 0.0
    waves = np.flatnonzero(np.diff(under_way.astype(int)) == 1)
    assert abs(len(waves) - 8) <= 1
    depth = depth_at(times[waves[3]] + np.arange(0.0, 60.0, 5.0))
    assert depth.max() == pytest.approx(giant.amplitude, abs=0.01)
    start = np.argmax(depth.max(axis=1) > 0.0) + 2
    way = depth[[start, start + 2]].argmax(axis=1) * muscle.layout.arc_length[1]
    assert (way[1] - way[0]) / 10.0 == pytest.approx(giant.speed, rel=0.05)
    swept = np.flatnonzero(depth.max(axis=0) > 0.0)
    assert np.ptp(swept) * muscle.layout.arc_length[1] == pytest.approx(giant.extent, rel=0.05)


def test_segments_of_an_organ() -> None:
    organ = straight_gut({"antrum": 0.1, "pylorus": 0.02, "duodenum": 0.2, "ileum": 0.4})
    layout = Muscle(organ, Motility(), np.random.default_rng(0)).layout
    assert layout.names == ("antrum", "pylorus", "duodenum", "ileum")
    assert list(layout.zones) == ["stomach", "duodenum", "ileum"]
    assert layout.zones["duodenum"] == pytest.approx((0.12, 0.32), abs=3e-3)
    assert (np.diff(layout.pace) >= 0).all()
    whole = straight_gut({"small-bowel": 1.0})
    assert Muscle(whole, Motility(), np.random.default_rng(0)).layout.names == ("jejunum", "ileum")


def test_unknown_segment() -> None:
    organ = straight_gut({"pipe": 0.3})
    with pytest.raises(UnknownNameError, match=r"No segment with muscle named 'pipe'. Known: antr"):
        Muscle(organ, Motility(), np.random.default_rng(0))
    stand_in = Muscle(organ, Motility(fallback_segment="ileum"), np.random.default_rng(0))
    assert stand_in.layout.names == ("ileum",)


def test_draws_are_uniform_and_independent() -> None:
    one, other = np.meshgrid(np.arange(300.0), np.arange(-150.0, 150.0))
    draws = uniform(12345, 1, one.ravel(), other.ravel())
    count = np.histogram(draws, 64, (0.0, 1.0))[0]
    assert ((count - len(draws) / 64) ** 2).sum() / (len(draws) / 64) < 110.0  # χ², 63 degrees
    square = draws.reshape(300, 300)
    for shifted in (square[:, 1:], square[1:, :]):
        cut = square[: shifted.shape[0], : shifted.shape[1]]
        assert abs(np.corrcoef(cut.ravel(), shifted.ravel())[0, 1]) < 0.015
    again = uniform(12345, 2, one.ravel(), other.ravel())
    assert abs(np.corrcoef(draws, again)[0, 1]) < 0.015


def test_a_front_that_is_begun_brings_phase_three_and_changes_nothing_before() -> None:
    """Within 2 s, evenly, and the same whenever it was known."""
    gut = straight_gut({"jejunum": 0.4}, edge=4e-3)
    plain = Muscle(gut, Motility(), np.random.default_rng(5))
    begun = plain.with_fronts((Front(30.0, 0.2),))
    known = Muscle(gut, Motility(fronts=(Front(30.0, 0.2),)), np.random.default_rng(5))
    for time in (3.0, 29.99, 31.0, 60.0):
        np.testing.assert_array_equal(begun.lumen_scale(time), known.lumen_scale(time))
    np.testing.assert_array_equal(begun.lumen_scale(29.99), plain.lumen_scale(29.99))
    assert begun.phase(np.array(0.2), 30.1) == 3
    assert begun.strength(np.array([0.2]), 32.1) == 1.0
    times = np.arange(29.9, 34.0, 0.02)
    steps = np.abs(np.diff([begun.lumen_scale(time) for time in times], axis=0))
    assert steps.max() < 0.05
    assert min(begun.lumen_scale(time)[150:250].min() for time in times) < 0.7


def test_a_muscle_that_is_asleep_rests_until_its_first_front() -> None:
    gut = straight_gut({"ileum": 0.2}, edge=4e-3)
    asleep = Muscle(gut, Motility(is_asleep=True), np.random.default_rng(5))
    assert (asleep.lumen_scale(1234.0) == 1.0).all()
    assert asleep.phase(np.array(0.1), 3.0) == 0
    assert asleep.strength(np.array([0.1]), 3.0) == 0.0
    woken = asleep.with_fronts((Front(7.0, 0.1),))
    assert (woken.lumen_scale(6.99) == 1.0).all()
    assert min(woken.lumen_scale(time).min() for time in np.arange(9.0, 20.0, 0.5)) < 0.6


def test_no_front_begins_where_none_passes() -> None:
    colon = Muscle(straight_gut({"sigmoid": 0.2}), Motility(), np.random.default_rng(0))
    with pytest.raises(InputError, match="Phase III starts only where the migrating motor complex"):
        colon.with_fronts((Front(1.0, 0.1),))
    with pytest.raises(InputError, match="A front's arc_length is -1"):
        Front(0.0, -1.0)
    with pytest.raises(InputError, match="A front's time is nan"):
        Front(np.nan, 0.0)
