"""Commands of a drive without a browser: policies, names, drivers, the next drive's fields."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from tests.support.waiting import wait_until
from vrcaps.actuation.arm.arm import read_arm
from vrcaps.actuation.coil_program import CoilSteering
from vrcaps.cockpit import messages
from vrcaps.cockpit.driving.drive_commands import EpisodeRecording, drive_handlers
from vrcaps.cockpit.driving.drive_page import DrivePage
from vrcaps.cockpit.driving.drive_setup import QUANTITIES, Readings, limit_text, lost_text
from vrcaps.cockpit.driving.new_drive import next_scenario
from vrcaps.cockpit.episode_page import EpisodePage
from vrcaps.cockpit.messages import NewDrive, Severity
from vrcaps.cockpit.page import FieldError, parse_command
from vrcaps.cockpit.session.drive import cockpit_scenario
from vrcaps.cockpit.session.seen_wall import _segments
from vrcaps.cockpit.session.session import Session
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.magnet.sources import Sphere
from vrcaps.scenario.scenario import OrganGenerated, Scenario


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return cockpit_scenario(Scenario("stomach", "magnetic")).scenario


REFUSED = {
    "organ": (NewDrive(organ="/etc/passwd"), "No organ named"),
    "capsule": (NewDrive(capsule="mirocam"), "No capsule named 'mirocam'"),
    "capsule_file": (NewDrive(capsule_file="missing.toml"), "missing.toml"),
    "lesions": (NewDrive(lesions="wart"), "No lesion named 'wart'"),
    "magnet": (NewDrive(magnet="horseshoe"), "No magnet named"),
    "arm": (NewDrive(arm="../panda"), "No arm named"),
    "coils": (NewDrive(coils="helmholtz"), "No coils named"),
    "severities": (NewDrive(severities=(Severity("sun", 1),)), "No effect named 'sun'"),
}


@pytest.mark.parametrize("field", REFUSED)
def test_a_choice_that_cannot_be_names_its_field(scenario, field):
    command, text = REFUSED[field]
    with pytest.raises(FieldError, match=text) as caught:
        next_scenario(scenario, command, "127.0.0.1")
    assert caught.value.field == field
    assert "\n" not in str(caught.value)


def test_files_are_read_only_if_no_other_machine_reaches_the_page(scenario):
    with pytest.raises(FieldError, match="no other machine can reach the page"):
        next_scenario(scenario, NewDrive(capsule_file="mine.toml"), "0.0.0.0")


def test_what_is_not_chosen_stays_the_same(scenario):
    assert next_scenario(scenario, NewDrive(), "127.0.0.1") == scenario
    chosen = NewDrive("colon", 3, "polyp-Is", severities=(Severity("bubbles", 2),), arm="none")
    after = next_scenario(scenario, chosen, "127.0.0.1")
    assert after.organ == OrganGenerated("colon", seed=3)
    assert [lesion.kind for lesion in after.lesions] == ["polyp"]
    assert after.motion.magnet.arm is None
    own = replace(scenario.motion.magnet, magnet=Sphere(0.03, 1.4), arm=read_arm("panda"))
    own = replace(scenario, motion=replace(scenario.motion, magnet=own))
    assert next_scenario(own, NewDrive(magnet="own sphere", arm="panda"), "127.0.0.1") == own
    assert after.contents.bubbles == 2
    assert replace(after, organ=scenario.organ, motion=scenario.motion, lesions=()) == replace(
        scenario, contents=after.contents
    )


def test_coils_replace_the_magnet_and_back(scenario):
    coils = next_scenario(scenario, NewDrive(coils="table-3x3"), "127.0.0.1")
    assert coils.motion.magnet is None
    assert coils.motion.coils == CoilSteering()
    driven = cockpit_scenario(coils).scenario
    same = NewDrive(coils="table-3x3", magnet="cylinder-76.2", arm="panda")
    assert next_scenario(driven, same, "127.0.0.1") == driven
    back = next_scenario(driven, NewDrive(coils="none", arm="none"), "127.0.0.1")
    assert back.motion.coils is None
    assert back.motion.magnet.arm is None


@pytest.mark.slow
def test_a_page_of_coils_shows_currents_and_temperatures(drive_scenario, tmp_path):
    """It offers no policy, since policies act by the magnet."""
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    from tests.support.cockpit_browser import free_port
    from vrcaps.cockpit.cockpit import open_cockpit

    motion = replace(drive_scenario.motion, magnet=None, coils=CoilSteering())
    scenario = replace(drive_scenario, motion=motion)
    with open_cockpit(scenario, tmp_path / "drive", port=free_port()) as cockpit:
        page, session = cockpit.page, cockpit.session
        wait_until(lambda: session.view is not None)
        setup = page.setup()
        assert setup["coils"] == [{"maxCurrent": 60.0, "maxTemperature": 90.0}] * 9
        assert (setup["hasMagnet"], setup["policies"]) == (False, [])
        assert setup["controls"]["x+"] == "pull to +x"
        assert setup["newDrive"]["coils"] == "table-3x3"
        session.operator.push(np.array([0.0, 0, 1.0, 0, 0, 0]))
        wait_until(lambda: max(abs(current) for current, _ in page.status()["coils"]) > 1.0)
        set_current = page._handlers[messages.SetCurrent]
        set_current(1, messages.SetCurrent(3, 12.5))
        assert page.status()["setCurrents"] == [0.0, 0.0, 12.5, *[0.0] * 6]
        with pytest.raises(InputError, match=r"current of coil 3 is 61 A\. Allowed: -60 to 60 A"):
            set_current(1, messages.SetCurrent(3, 61.0))
        page.scene.pace.interval = 0.0
        page.update()
        low, high = page.box("all")
        assert low[2] < session.rollout.coils.T_world_array[2, 3] < high[2]


def test_a_current_is_set_only_by_the_driver_and_only_with_coils(drive_scenario, tmp_path):
    known = {messages.SetCurrent.name: messages.SetCurrent}
    text = '{"id": 4, "command": "set-current", "coil": 2, "current": -3.5}'
    assert parse_command(text, known) == (4, messages.SetCurrent(2, -3.5))
    assert messages.SetCurrent.by_driver
    for given, allowed in (
        ('65, "current": 1', "coil"),
        ('2, "current": "much"', "current"),
        ("2", "current"),
    ):
        with pytest.raises(InputError, match=allowed) as caught:
            parse_command(f'{{"command": "set-current", "coil": {given}}}', known)
        assert "\n" not in str(caught.value)
    session = Session(drive_scenario, tmp_path / "drive")
    with pytest.raises(InputError, match=r"coil is 1\. Allowed: none: a magnet is driven"):
        session.operator.set_current(1, 1.0)


def test_names_that_are_not_offered_are_refused():
    """In particular a policy that was not allowed is not imported."""
    parts = MagicMock(policies=("mine.policies:Mine", "navigator"))
    parts.session.model.device.cameras = [SimpleNamespace(name="front")]
    handlers = drive_handlers(parts)
    for name in ("os:abort", "/etc/passwd", ""):
        with pytest.raises(UnknownNameError, match=r"Known: mine\.policies:Mine"):
            handlers[messages.StartPolicy](1, messages.StartPolicy(name))
    with pytest.raises(UnknownNameError, match="No camera named 'rear'"):
        handlers[messages.SetCamera](1, messages.SetCamera("rear", "rgb"))
    with pytest.raises(UnknownNameError, match="No channel named"):
        handlers[messages.SetCamera](1, messages.SetCamera("front", "flow_forward"))
    rendering = messages.SetRendering("direct", "x-ray", False)
    with pytest.raises(UnknownNameError, match="No imaging named 'x-ray'"):
        handlers[messages.SetRendering](1, rendering)
    effects = messages.SetRendering("direct", "white-light", False, (Severity("chyme", 1),))
    with pytest.raises(UnknownNameError, match="No image effect named 'chyme'"):
        handlers[messages.SetRendering](1, effects)


def test_every_command_has_a_handler_in_one_of_the_pages():
    handled = {*drive_handlers(MagicMock()), messages.FrameView}
    handled |= set(EpisodePage._commands_of_page(MagicMock()))
    assert handled == set(messages.Command.__subclasses__())


def test_a_policy_of_the_command_line_is_checked_before_the_page_opens(
    drive_scenario, tmp_path
) -> None:
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    from vrcaps.cockpit.cockpit import open_cockpit

    with pytest.raises(InputError, match="os:abort is not a policy"):
        open_cockpit(drive_scenario, tmp_path / "drive", policies=("os:abort",)).__enter__()
    with pytest.raises(InputError, match="mirocam contains no magnet"):
        open_cockpit(replace(drive_scenario, capsule="mirocam"), tmp_path / "drive").__enter__()
    missing = replace(drive_scenario, organ=str(tmp_path / "missing.glb"))
    with pytest.raises(InputError, match=r"No file at .*missing.glb. Give the path of an organ"):
        open_cockpit(missing, tmp_path / "drive").__enter__()
    assert list(tmp_path.iterdir()) == []


def test_only_the_driver_may_change_the_simulation():
    page: Any = SimpleNamespace(_driver=1)
    page.require_driver = lambda client: DrivePage.require_driver(page, client)
    DrivePage.check(page, 1, messages.Pause())
    DrivePage.check(page, 2, messages.TakeControl())
    DrivePage.check(page, 2, messages.FrameView("capsule"))
    with pytest.raises(InputError, match="Another browser has control"):
        DrivePage.check(page, 2, messages.Pause())


def test_axes_of_a_browser_that_only_watches_are_ignored():
    page: Any = MagicMock(_driver=1)
    axes = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert DrivePage.at_once(page, 2, messages.Steer(axes))
    page.session.operator.push.assert_not_called()
    assert DrivePage.at_once(page, 1, messages.Steer(axes))
    np.testing.assert_array_equal(page.session.operator.push.call_args[0][0], axes)
    assert not DrivePage.at_once(page, 1, messages.Pause())


def test_a_recording_that_fails_says_why_and_lets_another_start(tmp_path):
    drive: Any = MagicMock(folder=tmp_path)
    drive.save.side_effect = OSError("disk full")
    recording = EpisodeRecording(drive, threading.Lock(), lambda text: None)
    run = recording.start()
    with pytest.raises(InputError, match="in progress"):
        recording.start()
    with pytest.raises(OSError, match="disk full"):
        run()
    assert recording.plain["state"] == "failed"
    assert "disk full" in recording.plain["error"]
    recording.start()


def test_readings_keep_a_minute_and_forget_what_was_rewound():
    seen: Any = SimpleNamespace(fraction=0.25)
    images: Any = SimpleNamespace(exposure=1.5)
    readings = Readings(seen, images)

    def view(time: float) -> Any:
        state = SimpleNamespace(
            time=time, coupling=None, contact=None, linear_velocity_world=np.array([0.003, 0, 0])
        )
        return SimpleNamespace(state=state)

    for time in (-0.1, 0.0, 0.05, 0.125, 0.25, 0.375):
        readings.update(view(time))
    assert [row[0] for row in readings.history()] == [0.0, 0.125, 0.25, 0.375]
    named = dict(zip([each.name for each in QUANTITIES], readings.latest, strict=True))
    assert (named["Speed"], named["Coverage"], named["Exposure"]) == (pytest.approx(3.0), 25.0, 1.5)
    assert np.isnan(named["Contact force"])
    readings.update(view(0.125))
    assert [row[0] for row in readings.history()] == [0.0, 0.125]


def test_a_segment_of_the_map_is_where_its_label_is_the_most_frequent():
    labels = np.array([[0, 0, 0, 1, -1, 1], [0, 1, 1, 1, -1, 0], [0, 0, 1, 1, -1, 1]])
    found = [(each.name, 6 * each.start, 6 * each.end) for each in _segments(labels, ("a", "b"))]
    assert found == [("a", 0, 2), ("b", 2, 4), ("b", 5, 6)]


def test_states_of_the_magnet_are_told_in_words():
    assert limit_text("") == lost_text("") == ""
    assert limit_text("collision") == "a collision of the arm"
    assert lost_text("wrong_wall") == "the capsule lies on another wall"
    assert limit_text("rise_time") == "rise time"  # of an actuator of another package
