"""A drive without a page: what was driven is recorded again to the last bit."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from tests.support.waiting import wait_until
from vrcaps.actuation.coil_program import CoilSteering
from vrcaps.actuation.steering_program import JoystickCommand, read_commands
from vrcaps.cockpit.driving.drive_setup import limit_text
from vrcaps.cockpit.session.operator import PolicyDriver
from vrcaps.cockpit.session.session import Session, _actuator_values
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import quaternion_from_matrix
from vrcaps.lumen.contents import Contents
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.recording.table import POSE_COLUMNS
from vrcaps.scenario.build import build
from vrcaps.scenario.scenario import Scenario, read_scenario


def test_all_commands_are_in_the_drive_and_go_with_what_is_forgotten(drive_scenario, tmp_path):
    scenario = replace(drive_scenario, contents=Contents(bubbles=1))
    session = Session(scenario, tmp_path / "drive")
    session.flush()
    with pytest.raises(InputError, match="previous flush is still in progress"):
        session.flush()
    session.start_phase_three()
    session.drive.save()
    motion = read_scenario(session.drive.folder / "drive.json").motion
    assert motion.flushes == session.rollout.settings.flushes
    assert [front.arc_length for front in motion.phase_three] == [session.rollout.front_arc_length]
    assert session.rollout.world.muscle is not None
    session._rewind(None)
    assert session.rollout.settings.flushes == session.rollout.settings.phase_three == ()
    assert (session.rollout.world.muscle.lumen_scale(99.0) == 1.0).all()


@contextmanager
def driving(scenario: Scenario, folder: Path, **more) -> Iterator[Session]:
    session = Session(scenario, folder, **more)
    session.start()
    try:
        yield session
    finally:
        session.close()


def run_to(session: Session, frame: int) -> None:
    """Simulates to a frame, as fast as it goes."""
    session.clock.speed = 4.0
    session.clock.run(until=frame / session.rollout.fps + 1e-6)
    wait_until(lambda: len(session.poses) > frame)


def navigator(session: Session) -> PolicyDriver:
    return PolicyDriver("navigator", session.rollout, posture="supine")


@pytest.mark.slow
def test_a_drive_is_recorded_again_to_the_same_bytes(drive_scenario, tmp_path):
    """With keys, a dragged magnet, a policy, a turn, an insufflation and a return to a snapshot."""
    with driving(drive_scenario, tmp_path / "drive") as session:
        session.operator.push(np.array([0.8, 0, 0, 0, 0, -0.3]))
        run_to(session, 2)
        session.operator.start_policy(navigator(session))
        run_to(session, 4)
        assert session.operator.policy == "navigator"
        snapshot = session.keep_snapshot()
        lost = session.poses
        session.turn("left-lateral")
        session.operator.push(np.array([-1.0, 1.0, 0, 0, 0, 0]))
        run_to(session, 7)
        assert session.operator.policy == ""
        session.go_back(snapshot)
        wait_until(lambda: len(session.poses) <= 5)
        np.testing.assert_array_equal(session.poses[:4], lost[:4])
        assert session.rollout.settings.posture_changes == ()
        pose = session.view.T_world_requested.copy()
        pose[:3, 3] += [0.02, -0.01, 0.0]
        session.operator.drag(pose, is_dragging=False)
        session.insufflate(1.1)
        session.turn("right-lateral")
        run_to(session, 10)
        driven = session.poses
    out = record(read_scenario(tmp_path / "drive" / "drive.json"), tmp_path / "episode")
    episode = read_episode(out)
    recorded = [episode.table.columns[f"capsule_{name}"] for name in POSE_COLUMNS]
    wxyz = [quaternion_from_matrix(pose[:3, :3]) for pose in driven]
    np.testing.assert_array_equal(np.transpose(recorded), np.hstack([driven[:, :3, 3], wxyz]))
    assert episode.table.columns["insufflation"][-1] > 1.0
    moved = np.ptp([episode.table.columns[f"magnet_{axis}_m"] for axis in "xyz"], axis=1)
    assert moved.max() > 0.01


def test_a_drive_without_commands_can_be_recorded(drive_scenario, tmp_path):
    """As one that was killed in its first second."""
    Session(drive_scenario, tmp_path / "drive").drive.save()
    scenario = read_scenario(tmp_path / "drive" / "drive.json")
    assert scenario.motion.magnet.joystick == (JoystickCommand(0.0),)
    build(scenario)


def test_says_what_cannot_be_done(drive_scenario, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    with pytest.raises(InputError, match="full is not empty"):
        Session(drive_scenario, tmp_path / "full")
    with pytest.raises(InputError, match="Cannot create the folder"):
        Session(drive_scenario, tmp_path / "full" / "a" / "b")
    with pytest.raises(UnknownNameError, match="No capsule named 'unknown'"):
        Session(replace(drive_scenario, capsule="unknown"), tmp_path / "unknown")
    assert not (tmp_path / "unknown").exists()
    session = Session(drive_scenario, tmp_path / "drive")
    with pytest.raises(InputError, match="No frame is complete"):
        session.keep_snapshot()
    with pytest.raises(UnknownNameError, match="No snapshot named '3 s'"):
        session.go_back("3 s")
    with pytest.raises(InputError, match="six numbers from -1 to 1"):
        session.operator.push(np.array([2.0, 0, 0, 0, 0, 0]))
    with pytest.raises(InputError, match=r"speed is 9. Allowed: 0.05 to 4"):
        session.clock.speed = 9
    session.turn("prone")
    with pytest.raises(InputError, match="still turning to prone"):
        session.turn("supine")
    with pytest.raises(InputError, match="contains neither bubbles nor chyme"):
        session.flush()
    session.start_phase_three()
    with pytest.raises(InputError, match="Phase III has already started"):
        session.start_phase_three()
    session.insufflate(1.2)
    with pytest.raises(InputError, match="previous change of insufflation"):
        session.insufflate(1.0)


@pytest.mark.slow
def test_snapshots_of_what_is_forgotten_are_forgotten(drive_scenario, tmp_path):
    with driving(drive_scenario, tmp_path / "drive") as session:
        run_to(session, 1)
        early = session.keep_snapshot()
        run_to(session, 3)
        late = session.keep_snapshot()
        session.go_back(early)
        wait_until(lambda: session.snapshots == (early,))
        with pytest.raises(UnknownNameError, match=f"No snapshot named '{late}'"):
            session.go_back(late)


@pytest.mark.slow
def test_a_world_that_cannot_step_pauses_at_its_last_frame(drive_scenario, tmp_path, monkeypatch):
    """It is told, and goes on when the driver wishes so."""
    told: list[str] = []
    with driving(drive_scenario, tmp_path / "drive", on_message=told.append) as session:
        run_to(session, 2)
        advance, poses = session.rollout._advance, session.poses

        def fail(*args):
            monkeypatch.setattr(session.rollout, "_advance", advance)
            raise InputError("The capsule would be in a source.")

        monkeypatch.setattr(session.rollout, "_advance", fail)
        session.clock.run()
        wait_until(lambda: bool(told))
        assert told == [
            "The capsule would be in a source. Paused at the last frame: resume, rewind or reset."
        ]
        assert session.clock.is_paused
        np.testing.assert_array_equal(session.poses[:3], poses[:3])
        frame = len(session.poses)
        run_to(session, frame + 1)


def half_written(path: Path, data: bytes) -> None:
    path.write_bytes(path.read_bytes() + data[:7])
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_told_and_the_next_save_writes_all(drive_scenario, tmp_path, monkeypatch):
    told: list[str] = []
    session = Session(drive_scenario, tmp_path / "drive", on_message=told.append)
    session.operator(0.0, 0.01)
    session.drive.save()
    session.operator.push(np.array([1.0, 0, 0, 0, 0, 0]))
    session.operator(0.1, 0.01)
    with monkeypatch.context() as patch:
        patch.setattr("vrcaps.cockpit.session.drive._append", half_written)
        session.close()
    assert told == [f"Cannot save the drive in {tmp_path / 'drive'}: No space left on device."]
    session.drive.save()
    _, commands = read_commands(tmp_path / "drive" / "commands.csv")
    assert [command.time for command in commands] == [0.0, 0.1]
    assert commands[1].linear == (1.0, 0.0, 0.0)


@pytest.mark.slow
def test_a_drive_by_coils_is_recorded_again_to_the_same_bytes(drive_scenario, tmp_path):
    """The axes are a force and a torque, or currents are set; nothing can be dragged."""
    motion = replace(
        drive_scenario.motion, magnet=None, coils=CoilSteering(), dynamics="quasi-static"
    )
    scenario = replace(drive_scenario, motion=motion)
    with driving(scenario, tmp_path / "drive") as session:
        run_to(session, 1)
        assert not session.view.coils.state.currents.any()
        session.operator.push(np.array([1.0, 0, 0.5, 0, 0, 0]))
        run_to(session, 4)
        view = session.view
        assert np.abs(view.coils.state.currents).max() > 1.0
        assert view.coils.state.temperatures.max() > 25.0
        with pytest.raises(InputError, match=r"Coils have no magnet to drag\. Use the keys"):
            session.operator.drag(np.eye(4))
        session.operator.set_current(2, -30.0)
        run_to(session, 6)
        assert session.view.coils.commands[1] == -30.0
        assert not np.delete(session.view.coils.commands, 1).any()
        session.operator.stop()
        run_to(session, 8)
        driven = session.poses
    header = (tmp_path / "drive" / "commands.csv").read_text().splitlines()[0]
    assert header.endswith(
        "angular_z,coil_1_a,coil_2_a,coil_3_a,coil_4_a,coil_5_a,coil_6_a,coil_7_a,coil_8_a,coil_9_a"
    )
    out = record(read_scenario(tmp_path / "drive" / "drive.json"), tmp_path / "episode")
    columns = read_episode(out).table.columns
    assert -30.0 in columns["coil_2_command_a"]
    recorded = np.transpose([columns[f"capsule_{axis}_m"] for axis in "xyz"])
    np.testing.assert_array_equal(recorded, driven[:, :3, 3])
    assert np.abs(columns["coil_5_current_a"]).max() > 0.0


def test_a_limit_of_coils_is_named(drive_scenario, tmp_path):
    motion = replace(drive_scenario.motion, magnet=None, coils=CoilSteering())
    session = Session(replace(drive_scenario, motion=motion), tmp_path / "drive")
    program = session.rollout.coils
    session.operator.push(np.array([0.01, 0, 0, 0, 0, 0]))
    program.control(session.rollout.world, 0.0, 1.0)
    assert (program.reached_limit, program.is_on) == ("", True)
    session.operator.push(np.array([1.0, 0, 0, 0, 0, 0]))
    program.control(session.rollout.world, 0.0, 0.01)
    assert program.reached_limit == "current"
    assert limit_text(program.reached_limit) == "their maximum current"
    np.testing.assert_allclose(program.target, [motion.coils.joystick_force, 0, 0, 0, 0, 0])
    coupling = SimpleNamespace(force_world=0.6 * program.target[:3])
    rollout = MagicMock(coils=program)
    rollout.world.state.coupling = coupling
    assert _actuator_values(rollout)["lost"] == ""
    coupling.force_world *= 0.5
    assert _actuator_values(rollout)["lost"] == "insufficient_force"
    session.operator.stop()
    program.control(session.rollout.world, 0.0, 10.0)
    assert _actuator_values(rollout)["lost"] == ""
    assert (program.reached_limit, program.is_on) == ("", False)
