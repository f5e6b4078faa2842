"""Commands are checked once, at the border; answers are JSON."""

from __future__ import annotations

import json
import math
from typing import get_type_hints

import pytest

from vrcaps.cockpit import messages
from vrcaps.cockpit.messages import (
    MAX_COMMAND,
    Acknowledgement,
    Command,
    NewDrive,
    Rewind,
    Setup,
    Severity,
    Status,
    Steer,
    Viewpoint,
    encode,
)
from vrcaps.cockpit.page import parse_command
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError

KNOWN = {command.name: command for command in Command.__subclasses__()}


def text_of(command: str, **fields: object) -> str:
    return json.dumps({"id": 7, "command": command, **fields})


def test_a_command_is_read_with_its_id():
    assert parse_command(text_of("rewind", snapshot="1.20 s"), KNOWN) == (7, Rewind("1.20 s"))
    axes = (0.0, 0.5, -1.0, 0.0, 0.0, 1.0)
    assert parse_command(text_of("steer", axes=axes), KNOWN) == (7, Steer(axes))
    severities = [{"name": "chyme", "severity": 2}]
    wanted = NewDrive(organ="colon", seed=3, severities=(Severity("chyme", 2),))
    given = parse_command(text_of("new-drive", organ="colon", seed=3, severities=severities), KNOWN)
    assert given == (7, wanted)


HOSTILE = {
    "": "is not JSON",
    "[" * 5000: "is not JSON",
    "[1]": "is not a command",
    '{"command": 3}': "is not a command",
    '{"command": "pause", "id": true}': "id of a command is invalid",
    '{"command": "pause", "id": -1}': "id of a command is invalid",
    '{"command": "os.abort"}': "No command named 'os.abort'",
    text_of("pause", now=1): "Unknown key pause.now",
    text_of("rewind"): "Missing key rewind.snapshot",
    text_of("rewind", snapshot=["a"]): "rewind.snapshot is .* Allowed: a string",
    text_of("set-speed", speed=99.0): "speed is 99.0. Allowed: 0.05 to 8",
    text_of("set-speed", speed="fast"): "Allowed: a number",
    text_of("steer", axes=[0, 0]): "Allowed: 6",
    text_of("steer", axes=[0, 0, 0, 0, 0, 1.5]): "Allowed: six numbers from -1 to 1",
    text_of("steer", axes=[0, 0, 0, 0, 0, math.nan]): "Allowed: six numbers from -1 to 1",
    text_of("frame-view", target="/etc/passwd"): "Allowed: 'capsule', 'organ', 'all'",
    text_of("new-drive", seed=-1): "seed is -1. Allowed: 0 to",
    text_of("new-drive", severities=[{"name": "blur", "severity": 99}]): "blur's severity is 99",
    text_of("rewind", snapshot="x" * MAX_COMMAND): "Allowed: 8192",
}


@pytest.mark.parametrize("text", HOSTILE, ids=lambda text: text[:40])
def test_anything_else_is_refused_in_one_line(text):
    with pytest.raises(VrcapsError, match=HOSTILE[text]) as caught:
        parse_command(text, KNOWN)
    assert "\n" not in str(caught.value)


def test_a_page_takes_its_own_commands_only():
    known = {"select-frame": messages.SelectFrame}
    with pytest.raises(UnknownNameError):
        parse_command(text_of("reset"), known)
    assert parse_command(text_of("select-frame", frame=3), known)[1] == messages.SelectFrame(3)


def test_names_of_commands_are_unique_and_their_fields_typed():
    assert len(KNOWN) == len(Command.__subclasses__()) > 20
    assert all(get_type_hints(command) for command in KNOWN.values())


def test_numbers_that_are_not_finite_become_null():
    viewpoint = Viewpoint([[1.0, 0.0, 0.0]], [[0.0, 1.0, math.inf]], 0.3)
    plain = json.loads(encode(Status({"readings": (1.5, math.nan)}, viewpoint)))
    assert plain["values"] == {"readings": [1.5, None]}
    assert plain["viewpoint"]["patient"] == [[0.0, 1.0, None]]
    assert json.loads(encode(Acknowledgement(3)))["type"] == "acknowledgement"
    assert json.loads(encode(Setup(2, {"folder": "runs"})))["values"]["folder"] == "runs"


def test_a_severity_names_its_effect():
    with pytest.raises(InputError, match="blur's severity is -1"):
        Severity("blur", -1)
