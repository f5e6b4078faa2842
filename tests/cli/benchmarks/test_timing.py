from __future__ import annotations

import numpy as np
import pytest

from vrcaps.cli.benchmarks import report
from vrcaps.cli.benchmarks.report import Spread, Subject, Times, interleave, ratio


def test_turns_alternate_and_every_view_is_drawn_once_a_round() -> None:
    calls: list[tuple[str, int]] = []

    def subject(name: str) -> Subject:
        return Subject(name, lambda view: calls.append((name, view)))

    rounds: list[None] = []
    interleave(
        [subject("a"), subject("b")],
        num_views=3,
        num_rounds=2,
        progress=lambda: rounds.append(None),
    )
    turn = [2, 0, 1, 2]  # the first brings the last view back and is not timed
    order = ["a", "b", "b", "a", "a", "b"]  # each round starts with another
    assert calls == [(name, view) for name in order for view in turn]
    assert len(rounds) == 3


def test_times_are_of_one_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clocks that only drawing moves: 2 and 4 ms on the wall, half of it on the processor."""
    now = [0.0]

    def draw(view: int) -> None:
        now[0] += 2e-3 * (1 + view)

    monkeypatch.setattr(report.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(report.time, "process_time", lambda: 0.5 * now[0])
    times = interleave([Subject("s", draw)], num_views=2, num_rounds=3)["s"]
    np.testing.assert_allclose(times.wall, [3e-3] * 3)
    np.testing.assert_allclose(times.cpu, [1.5e-3] * 3)


def test_a_drift_of_the_machine_cancels_in_ratios() -> None:
    drift = np.linspace(1.0, 5.0, 21)
    one, two = Times(1e-3 * drift, drift), Times(2e-3 * drift, drift)
    assert ratio(two, one) == Spread(pytest.approx(2.0), pytest.approx(2.0), pytest.approx(2.0))


def test_spread_is_median_and_percentiles() -> None:
    values = np.arange(101.0)
    assert Spread.of(values) == Spread(50.0, 10.0, 90.0)
    assert Spread.of(values).scaled(2.0) == Spread(100.0, 20.0, 180.0)
