"""The scene gives way in browsers that draw slowly, and comes back."""

from __future__ import annotations

import pytest

from vrcaps.cockpit import pace as pace_module
from vrcaps.cockpit.pace import Pace, parse_rate


def test_the_slowest_browser_sets_the_pace_as_long_as_it_says_something(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(pace_module.wall_clock, "monotonic", lambda: now[0])
    pace = Pace()
    pace.note(1, 60.0)
    assert pace.interval == pytest.approx(0.05)
    for _ in range(20):
        pace.note(2, 3.0)
        pace.note(1, 60.0)
        now[0] += 1.0
    assert pace.interval == pytest.approx(1.0)
    now[0] += 5.0  # the slow one is gone
    for _ in range(40):
        pace.note(1, 60.0)
        now[0] += 1.0
    assert pace.interval == pytest.approx(0.05)
    before = pace.interval
    pace.note(1, 25.0)  # neither slow nor fast
    assert pace.interval == before


@pytest.mark.parametrize("text", ["", "vrcaps-frames:", "vrcaps-frames:x", "vrcaps-frames:-1", "7"])
def test_nonsense_is_no_rate(text):
    assert parse_rate(text) is None
    assert parse_rate("vrcaps-frames:nan") is None


def test_reads_what_the_program_in_the_browser_writes():
    assert parse_rate("vrcaps-frames:12.5 1700000000000") == 12.5
