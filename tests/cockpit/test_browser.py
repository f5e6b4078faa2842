"""What a browser says of keys and gamepad, and what is no such thing."""

from __future__ import annotations

import json

import pytest

from vrcaps.cockpit.browser import DriverInput, parse_input
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
    with pytest.raises(InputError, match="A browser sent no driver's input"):
        parse_input(text)


@pytest.mark.parametrize("axes", [[0, 0], [0, 0, 0, 0, 0, float("nan")]])
def test_axes_are_six_numbers(axes):
    said = {"axes": axes, "pad": "", "standard": True, "actions": []}
    with pytest.raises(InputError, match="Allowed: six numbers"):
        parse_input(json.dumps(said))
