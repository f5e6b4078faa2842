"""The clock against the published distributions it is drawn from."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.units import CM
from vrcaps.tissue.motility.migrating_complex import (
    MINUTE,
    ComplexStatistics,
    MigratingMotorComplex,
    draw_complex,
)

ZONES = {
    "stomach": (0.0, 0.15),
    "duodenum": (0.15, 0.4),
    "jejunum": (0.4, 1.7),
    "ileum": (1.7, 3.65),
}


def patient(seed: int, **changes: object) -> MigratingMotorComplex:
    return draw_complex(ComplexStatistics(**changes), ZONES, np.random.default_rng(seed))


def test_phases_come_in_order_and_fill_the_cycle() -> None:
    clock = replace(patient(0, reaching=(1.0, 1.0), origins=(1.0, 0.0, 0.0, 0.0)), offset=0.0)
    time = np.arange(0.0, clock.starts[40], 5.0)
    phase, passed = clock.phase(np.full(time.shape, 0.3), time)
    assert ((passed >= 0.0) & (passed <= 1.0)).all()
    steps = {(a, b) for a, b in itertools.pairwise(phase) if a != b}
    assert steps <= {(1, 2), (2, 3), (3, 4), (4, 1), (3, 1), (4, 2), (1, 3), (3, 2)}
    assert {(1, 2), (2, 3), (4, 1)} <= steps


def test_front_arrives_after_the_way_at_its_speeds() -> None:
    clock = patient(1)
    speed = np.diff(clock.positions) / np.diff(clock.delays)
    assert (np.diff(speed[1:]) <= 0.0).all()  # falls from the duodenum on
    clock = clock.at_front(1.0)
    for ahead in (1.0, 1e-3):
        assert clock.phase(np.array([1.0]), -ahead)[0] != 3
        assert clock.phase(np.array([1.0]), ahead)[0] == 3
    assert clock.at_front(1.0, ahead=60.0).phase(np.array([1.0]), 61.0)[0] == 3


def test_the_first_cycle_comes_again_after_the_last() -> None:
    clock = patient(2)
    place, time = np.full(500, 0.8), np.linspace(0.0, 5e5, 500)
    again = clock.phase(place, time + clock.starts[-1])
    np.testing.assert_array_equal(clock.phase(place, time)[0], again[0])


def test_cycles_of_patients() -> None:
    """Means of 113 to 230 min, deviation 58 to 70 min before their limits, at least 15 min."""
    lengths = [np.diff(patient(seed).starts) / MINUTE for seed in range(30)]
    means = np.array([x.mean() for x in lengths])
    assert 105.0 < means.min() < 135.0
    assert 205.0 < means.max() < 240.0
    deviation = np.array([x.std() for x in lengths])
    assert (deviation < 70.0).all()
    assert deviation[means > 150.0].min() > 48.0
    assert min(x.min() for x in lengths) >= 15.0


def test_origins_and_reach() -> None:
    clocks = [patient(seed) for seed in range(12)]
    first = np.concatenate([c.first for c in clocks])
    shares = [np.mean(first == place) for place in (-np.inf, 0.15, 0.275, 0.4)]
    np.testing.assert_allclose(shares, [0.71, 0.18, 0.10, 0.01], atol=0.03)
    last = np.concatenate([c.last for c in clocks])
    assert np.mean(last >= 0.5 * (0.15 + 3.65)) == pytest.approx(0.45, abs=0.03)
    assert np.mean(last >= 3.65) == pytest.approx(0.1, abs=0.03)
    assert (last >= np.where(np.isfinite(first), first, 0.15)).all()


def test_third_phase_lengthens_down_the_gut() -> None:
    clock = replace(patient(3, reaching=(1.0, 1.0)), offset=0.0)
    for place, low, high in ((0.2, 5.0, 7.7), (3.6, 7.3, 10.0)):
        time = np.arange(0.0, clock.starts[60], 1.0)
        third = clock.phase(np.full(time.shape, place), time)[0] == 3
        edges = np.flatnonzero(np.diff(third.astype(int)))
        spans = np.diff(edges)[::2] if not third[0] else np.diff(edges)[1::2]
        assert low - 0.1 < spans.min() / 60.0
        assert spans.max() / 60.0 < high + 0.1


def test_without_deviation_all_patients_are_the_mean() -> None:
    speeds = {
        "stomach": (1 * CM, 0.0),
        "duodenum": (1 * CM, 0.0),
        "jejunum": (1 * CM, 0.0),
        "ileum": (1 * CM, 0.0),
        "terminal": (1 * CM, 0.0),
    }
    clock = patient(0, cycle_means=(6000.0, 6000.0), cycle_deviation=0.0, front_speeds=speeds)
    np.testing.assert_allclose(np.diff(clock.starts), 6000.0)
    np.testing.assert_allclose(np.diff(clock.positions) / np.diff(clock.delays), 1 * CM)


def test_rejects_a_place_without_fronts() -> None:
    clock = patient(0)
    with pytest.raises(InputError, match="No front passes at 99 m"):
        clock.at_front(99.0)


def test_rejects_an_organ_without_zones() -> None:
    with pytest.raises(InputError, match="requires a stomach or small bowel"):
        draw_complex(ComplexStatistics(), {}, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("cycle_means", (3.0, 2.0), "cycle_means is .* two ascending times"),
        ("third_phase", (-1.0, 2.0), "third_phase is"),
        ("fourth_phase", (0.0, float("inf")), "fourth_phase is"),
        ("shortest_cycle", 7000.0, "shortest_cycle is 7000.0"),
        ("cycle_deviation", -1.0, "cycle_deviation is -1.0"),
        ("second_phase_deviation", float("nan"), "second_phase_deviation is nan"),
        ("gastric_first_phase", (0.5, 2.0), "gastric_first_phase is"),
        ("second_phase", (-0.1, 0.5), "second_phase is"),
        ("reaching", (2.0, 0.0), "reaching is"),
        ("origins", (0.5, 0.1, 0.1, 0.1), "origins is .* with sum 1"),
        ("front_speeds", {"jejunum": (1.0, 0.0)}, "front_speeds is .* terminal"),
    ],
)
def test_rejects(field: str, value: object, match: str) -> None:
    with pytest.raises(InputError, match=match):
        ComplexStatistics(**{field: value})
