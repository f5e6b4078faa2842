"""A run whose capsule a magnet steers: what may be asked for, and that it is done."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.actuation.steering_program import (
    JOYSTICK_COLUMNS,
    WAYPOINT_COLUMNS,
    JoystickCommand,
    MagnetSteering,
    Waypoint,
    check_joystick,
    check_waypoints,
    read_commands,
)
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import DEG
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.dynamics_settings import ESTIMATE_COLUMNS, MAGNET_COLUMNS
from vrcaps.motion.rollout import Rollout
from vrcaps.recording.table import make_table
from vrcaps.world.model import Model, posture_transform
from vrcaps.world.schedule import PostureChange

PATH = (Waypoint(0.0, 0.06), Waypoint(1.0, 0.065), Waypoint(2.0, 0.065))


@pytest.fixture(scope="module")
def gut_model() -> Model:
    gut = straight_gut({"jejunum": 0.2}, radius=0.014)
    return Model(gut, read_device("magnetic"), posture_transform("supine"))


def simulate(model: Model, steering: MagnetSteering, frames: int = 7, fps: float = 3.0):
    motion = Dynamics(start=0.3, settle=0.5, substep=2e-4, magnet=steering)
    return Rollout(model, motion, frames=frames, fps=fps, seed=0)


@pytest.mark.slow
def test_an_arm_leads_the_capsule_from_place_to_place(gut_model):
    steering = MagnetSteering(waypoints=PATH, arm="panda", standoff=0.1)
    run = simulate(gut_model, steering)
    table = make_table(gut_model, run).columns
    assert set(MAGNET_COLUMNS) < set(table)
    assert table["arc_length_m"][-1] == pytest.approx(0.065, abs=2e-3)
    assert set(table["coupling_lost"]) == {""}
    joints = np.array([table[f"joint_{k}_rad"] for k in range(1, 8)])
    assert np.abs(np.diff(joints)).max() < 0.5
    force = np.array([table[f"magnetic_force_{axis}_n"] for axis in "xyz"])
    assert 0.0 < force[2, -1] < gut_model.device.mass * 9.81
    assert table["magnet_z_m"].min() > gut_model.vertices_world[:, 2].max() + 0.1
    assert table["coupling_angle_rad"].max() < 0.3


def test_says_when_the_arm_could_not_carry_the_magnet(gut_model):
    """The default one it can; a free hand has no such limit."""
    assert simulate(gut_model, MagnetSteering(arm="panda", standoff=0.1)).notes == ()
    assert simulate(gut_model, MagnetSteering("cylinder-101.6")).notes == ()
    (note,) = simulate(gut_model, MagnetSteering("cylinder-101.6", arm="panda", standoff=0.1)).notes
    assert "6.2 kg, but arm panda may carry 3 kg" in note


def test_an_arm_that_was_jogged_to_its_limit_comes_back(gut_model):
    """Beyond reach it stands, whatever else is asked of it there; the way it came is free."""
    still = (JoystickCommand(0.0),)
    run = simulate(gut_model, MagnetSteering(arm="panda", standoff=0.1, joystick=still))
    assert run.program is not None
    controller = run.program.controller

    def jog(axis: float, steps: int) -> float:
        for _ in range(steps):
            controller.jog((axis, 0, 0), (0, 0, 0), 0.01, speed=0.1, angular_speed=0.5)
        return float(controller.status.actuator.T_world_magnet[0, 3])

    start = jog(0.0, 1)
    far = jog(1.0, 600)
    assert controller.status.actuator.limit == "unreachable"
    assert far - start < 0.5
    assert jog(-1.0, 300) < far - 0.2
    assert controller.status.actuator.limit in ("", "speed")


@pytest.mark.slow
def test_the_capsule_is_led_by_its_located_pose(gut_model):
    """The table has the estimate beside the true pose; the capsule still comes where it shall."""
    run = simulate(gut_model, MagnetSteering(waypoints=PATH, pose="located"))
    table = make_table(gut_model, run).columns
    assert set(ESTIMATE_COLUMNS) < set(table)
    true, found = (
        np.array([table[f"{name}_{axis}_m"] for axis in "xyz"]) for name in ("capsule", "estimated")
    )
    error = np.linalg.norm(found - true, axis=0)
    assert 0.0 < error.max() < 4e-3
    assert table["arc_length_m"][-1] == pytest.approx(0.065, abs=4e-3)


@pytest.mark.slow
def test_a_joystick_moves_the_magnet(gut_model):
    steering = MagnetSteering(
        joystick=(JoystickCommand(0.2, (1.0, 0.0, 0.0)), JoystickCommand(0.4)), joystick_speed=0.05
    )
    states = [step.command.controller for step in simulate(gut_model, steering, 4).steps()]
    moved = states[-1].actuator.T_world_magnet[:3, 3] - states[0].actuator.T_world_magnet[:3, 3]
    np.testing.assert_allclose(moved, [0.01, 0.0, 0.0], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("pose", ["true", "located"])
def test_goes_on_from_a_snapshot(gut_model, pose):
    steering = MagnetSteering(waypoints=PATH, pose=pose)
    run = simulate(gut_model, steering, 4, 20.0)
    poses = []
    for step in run.steps(is_due=lambda: True):
        poses.append(step.state.T_world_capsule)
        if step.index == 1:
            taken = run.checkpoint()
    again = [
        step.state.T_world_capsule for step in simulate(gut_model, steering, 4, 20.0).steps(taken)
    ]
    np.testing.assert_array_equal(again, poses[2:])


@pytest.mark.slow
def test_without_commands_it_leads_along_the_wall_and_stops(gut_model):
    """From 0.06 m on, at 1 cm/s to 0.07 m; and back to 0.05 m, without a turn."""
    for until, end in ((0.35, 0.07), (0.25, 0.05)):
        run = simulate(gut_model, MagnetSteering(end=until, speed=0.01), 9, 4.0)
        places = [step.state.T_world_capsule for step in run.steps()]
        assert run.program.follower.has_arrived
        assert places[-1][0, 3] == pytest.approx(end, abs=2e-3)
        assert np.sign(places[-1][0, 2]) == np.sign(places[0][0, 2])


def test_the_way_goes_on_from_a_snapshot(gut_model):
    steering, poses, taken = MagnetSteering(end=0.5, speed=0.01), [], None
    run = simulate(gut_model, steering, 4, 20.0)
    for step in run.steps(is_due=lambda: True):
        poses.append(step.state.T_world_capsule)
        if step.index == 1:
            taken = run.checkpoint()
    again = simulate(gut_model, steering, 4, 20.0)
    rest = [step.state.T_world_capsule for step in again.steps(taken)]
    np.testing.assert_array_equal(rest, poses[2:])
    assert again.program.follower.arc_length == run.program.follower.arc_length > 0.0


def test_a_patient_who_turns_takes_the_way_along(gut_model):
    motion = Dynamics(
        start=0.3,
        settle=0.2,
        substep=2e-4,
        magnet=MagnetSteering(),
        posture_changes=(PostureChange("left-lateral", 0.0, 0.5),),
    )
    run = Rollout(gut_model, motion, frames=3, fps=5.0, seed=0)
    states = [step.command.controller for step in run.steps()]
    assert np.isfinite(states[-1].required_force).all()


def test_commands_are_read(tmp_path: Path):
    path = tmp_path / "commands.csv"
    path.write_text(",".join(WAYPOINT_COLUMNS) + "\n0,0.05,0,0\n2,0.1,30,-10\n")
    points = (Waypoint(0.0, 0.05), Waypoint(2.0, 0.1, 30 * DEG, -10 * DEG))
    assert read_commands(path) == (points, ())
    path.write_text(",".join(JOYSTICK_COLUMNS) + "\n0,1,0,0,0,0,-0.5\n")
    assert read_commands(path) == ((), (JoystickCommand(0.0, (1, 0, 0), (0, 0, -0.5)),))
    path.write_text("time_s,x\n0,1\n")
    with pytest.raises(InputError, match="not the header time_s,arc_length_m"):
        read_commands(path)


def test_what_cannot_be(gut_model):
    with pytest.raises(UnknownNameError, match="No wall named 'left'"):
        MagnetSteering(wall="left")
    with pytest.raises(InputError, match="Several of waypoints"):
        MagnetSteering(waypoints=PATH, command_file="x.csv")
    with pytest.raises(InputError, match=r"^speed is 0\.0\. Allowed: above 0 to 1 m/s"):
        MagnetSteering(speed=0.0)
    with pytest.raises(InputError, match=r"^end is 1\.5"):
        MagnetSteering(end=1.5)
    with pytest.raises(InputError, match="joystick_angular_speed is -1"):
        MagnetSteering(joystick_angular_speed=-1.0)
    with pytest.raises(InputError, match="here: entry 1 is not finite"):
        check_waypoints((PATH[0], Waypoint(np.nan, 0.1)), "here")
    with pytest.raises(InputError, match="does not come after"):
        check_waypoints((PATH[1], PATH[0]), "here")
    with pytest.raises(InputError, match="axes of -1 to 1"):
        check_joystick((JoystickCommand(0.0, (2.0, 0.0, 0.0)),), "here")
    with pytest.raises(InputError, match="A waypoint's arc_length is 5"):
        simulate(gut_model, MagnetSteering(waypoints=(Waypoint(0.0, 5.0),)))
    with pytest.raises(InputError, match="contains no magnet"):
        simulate(replace(gut_model, device=read_device("mirocam")), MagnetSteering())
    with pytest.raises(UnknownNameError, match="No arm named"):
        simulate(gut_model, MagnetSteering(arm="tentacle"))
    with pytest.raises(InputError, match="does not reach"):
        simulate(gut_model, MagnetSteering(arm="panda", arm_base=(5.0, 0.0, 0.0)))
