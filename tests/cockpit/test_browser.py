"""Messages of a browser about keys and gamepad, and rejection of all others."""

from __future__ import annotations

import json

import pytest

from vrcaps.cockpit import browser
from vrcaps.cockpit.browser import DriverInput, Pace, parse_input, parse_rate
from vrcaps.core.errors import InputError


def test_reads_what_the_program_in_the_browser_writes():
    said = {"axes": [0, 0.5, -2, 0, 0, 1], "pad": "P", "standard": False, "actions": ["pause"]}
    given = parse_input("vrcaps:" + json.dumps(said))
    assert given == DriverInput((0.0, 0.5, -1.0, 0.0, 0.0, 1.0), ("pause",), "P", False)


def test_a_layout_holds_controls_only():
    said = {"axes": [0] * 6, "pad": "P", "standard": True, "actions": [], "listening": "x+"}
    said["layout"] = {"x+": "axis 0 +", "pause": "button 0" * 9, "format": "disk"}
    given = parse_input("vrcaps:" + json.dumps(said))
    assert given.layout == {"x+": "axis 0 +", "pause": "button 0button 0butt"}
    assert given.listening == "x+"


NONSENSE = ("", "vrcaps:", "vrcaps:{}", "vrcaps:[1]", "vrcaps:" + "[" * 100_000)
WRONG_TYPE = 'vrcaps:{"axes": "abcdef", "pad": "", "standard": true, "actions": []}'


WRONG_LAYOUT = WRONG_TYPE.replace('"abcdef"', "[0, 0, 0, 0, 0, 0]").replace("}", ', "layout": 1}')


@pytest.mark.parametrize("text", [*NONSENSE, WRONG_TYPE, WRONG_LAYOUT])
def test_nonsense_is_told(text):
    with pytest.raises(InputError, match="A browser sent invalid input"):
        parse_input(text)


@pytest.mark.parametrize("axes", [[0, 0], [0, 0, 0, 0, 0, float("nan")]])
def test_axes_are_six_numbers(axes):
    said = {"axes": axes, "pad": "", "standard": True, "actions": []}
    with pytest.raises(InputError, match="Allowed: six numbers"):
        parse_input(json.dumps(said))


def test_the_slowest_browser_sets_the_pace_as_long_as_it_says_something(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(browser.wall_clock, "monotonic", lambda: now[0])
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


def test_reads_the_rate_that_the_program_in_the_browser_writes():
    assert parse_rate("vrcaps-frames:12.5 1700000000000") == 12.5
