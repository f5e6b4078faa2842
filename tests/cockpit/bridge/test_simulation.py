"""Messages of a live simulation: those of a recording with the same commands, each time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from vrcaps.actuation.arm.arm import read_arm
from vrcaps.actuation.arm.arm_with_payload import (
    ArmWithPayload,
    magnet_pose_at,
    transverse_mount,
)
from vrcaps.actuation.coil_program import CoilSteering, Currents
from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.actuation.steering_program import JoystickCommand, MagnetSteering
from vrcaps.cockpit.bridge.commands import CURRENTS, JOINTS, POSE, VELOCITY, ArmCommands
from vrcaps.cockpit.bridge.protocol import publication
from vrcaps.cockpit.bridge.simulation import LiveSimulation
from vrcaps.core.errors import InputError
from vrcaps.formats.robotics.ros2_bag import _Bag
from vrcaps.magnet.presets import read_magnet
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import Scenario

MAGNET = read_magnet("cylinder-50.8")
ZERO = {"x": 0.0, "y": 0.0, "z": 0.0}


def twist(x: float, nanosec: int = 0) -> dict:
    header = {"stamp": {"sec": 0, "nanosec": nanosec}, "frame_id": "world"}
    return {"header": header, "twist": {"linear": {**ZERO, "x": x}, "angular": ZERO}}


def pose(x: float, **orientation: float) -> dict:
    turn = {"w": 1.0, **ZERO, **orientation}
    return {"pose": {"position": {"x": x, "y": 0.0, "z": 0.3}, "orientation": turn}}


def messages(simulation: LiveSimulation, duration: float = 0.3) -> list:
    found = []
    simulation.run(found.extend, lambda: frozenset(simulation.kinds), duration)
    return found


@pytest.mark.slow
def test_messages_are_those_of_a_recording_with_the_same_commands(scenario, tmp_path):
    pytest.importorskip("rosbags")
    simulation = LiveSimulation(scenario, real_time_factor=0.0)
    assert simulation.commands.send(VELOCITY, twist(0.03, 100_000_000)) == ""
    assert simulation.commands.send(VELOCITY, twist(0.01)) == ""
    found = messages(simulation)
    steering = MagnetSteering(
        joystick=(
            JoystickCommand(0.0, (0.01 / 0.05, 0.0, 0.0)),
            JoystickCommand(0.1, (0.03 / 0.05, 0.0, 0.0)),
        )
    )
    motion = replace(scenario.motion, magnet=steering)
    recorded = replace(scenario, motion=motion, frames=4, variation=False)
    episode = read_episode(record(recorded, tmp_path / "episode"))
    by_topic: dict[str, list] = {}
    for message in found:
        by_topic.setdefault(message.topic, []).append(message)
        assert simulation.kinds[message.topic] == message.kind
    assert by_topic.keys() == simulation.kinds.keys()
    for k in range(4):
        for body in ("capsule", "magnet"):
            x, y, z = episode.table.poses(body)[k, :3, 3]
            position = by_topic[f"/{body}/pose"][k].fields["pose"]["position"]
            assert position == {"x": x, "y": y, "z": z}
        image = by_topic["/front/rgb"][k].fields["data"].reshape(24, 32, 3)
        np.testing.assert_array_equal(image, episode.image("front", "rgb", k))
        assert by_topic["/clock"][k].fields["clock"] == {"sec": 0, "nanosec": k * 10**8}
    with _Bag.writing(tmp_path / "bag") as bag:  # every field has its type
        for message in found:
            bag.send(message)


@pytest.mark.slow
def test_same_commands_give_the_same_messages(scenario):
    def run() -> list[str]:
        simulation = LiveSimulation(scenario, real_time_factor=0.0)
        simulation.commands.send(POSE, pose(0.2, y=0.0))
        return [publication(message) for message in messages(simulation)]

    first = run()
    assert first == run()
    other = LiveSimulation(replace(scenario, seed=1), real_time_factor=0.0)
    other.commands.send(POSE, pose(0.2))
    assert first != [publication(message) for message in messages(other)]


def test_commands_that_are_none_are_one_line(scenario):
    commands = LiveSimulation(scenario).commands
    for topic, message, error in (
        (VELOCITY, {}, "twist.linear is None. Allowed: numbers x, y, z"),
        (VELOCITY, twist(float("nan")), "twist.linear.x is nan. Allowed: a number"),
        (VELOCITY, twist(True), "twist.linear.x is True"),
        (VELOCITY, twist(0.0, -1), "nanosec is -1. Allowed: 0 to 999999999"),
        (VELOCITY, {**twist(0.0), "header": 7}, "header is 7"),
        (VELOCITY, {**twist(0.0), "header": {"frame_id": "map"}}, "frame_id is 'map'"),
        (POSE, pose(0.2, w=2.0), "pose.orientation has the norm 2. Allowed: 1"),
        (POSE, {"pose": []}, "pose.position is None"),
    ):
        with pytest.raises(InputError, match=error) as raised:
            commands.send(topic, message)
        assert "\n" not in str(raised.value)
    assert "clipped to 0.05 m/s" in commands.send(VELOCITY, twist(9.0))
    low = {**pose(0.2)["pose"], "position": {**ZERO, "z": -1.0}}
    assert "moved into the workspace" in commands.send(POSE, {"pose": low})
    with pytest.raises(InputError, match="1000 commands wait for their time"):
        for _ in range(1001):
            commands.send(VELOCITY, twist(0.0))
    commands.stop()
    assert commands(0.0, 0.01) == JoystickCommand(0.0)


def test_joint_angles_are_where_the_magnet_goes():
    program = SimpleNamespace(settings=MagnetSteering(), controller=MagicMock())
    robot = ArmWithPayload(
        read_arm("ur5e"), MAGNET, np.eye(4), transverse_mount(MAGNET), table_height=0.0
    )
    program.controller.actuator = RobotActuator(robot)
    commands = ArmCommands(program)
    angles = [0.1, *robot.arm.home[1:]]
    program.controller.status.actuator.joint_angles = np.array(angles)
    assert commands.send(JOINTS, {"position": angles}) == ""
    ((_, pose),) = commands._due(0.0)
    np.testing.assert_allclose(pose, magnet_pose_at(robot, np.array(angles)), atol=1e-12)
    assert commands.send(JOINTS, {"name": ["joint_6", "joint_1"], "position": [0.5, -0.2]}) == ""
    ((_, pose),) = commands._due(0.0)
    expected = magnet_pose_at(robot, np.array([-0.2, *angles[1:5], 0.5]))
    np.testing.assert_allclose(pose, expected, atol=1e-12)
    for message, error in (
        ({"position": [0.0]}, r"Allowed: 6 angles \[rad\]"),
        ({"name": ["joint_7"], "position": [0.0]}, "Allowed: joint_1 to joint_6, each once"),
        ({"name": "", "position": angles}, "name is ''. Allowed: joint_1 to joint_6"),
        ({"name": 0, "position": angles}, "name is 0"),
        ({"position": [0.0, 0.5, *[0.0] * 4]}, "collides with itself or the table"),
    ):
        with pytest.raises(InputError, match=error):
            commands.send(JOINTS, message)
    assert "clipped" in commands.send(JOINTS, {"position": [99.0, *robot.arm.home[1:]]})


def test_currents_are_those_of_the_program_and_clipped(coil_scenario):
    simulation = LiveSimulation(coil_scenario, real_time_factor=0.0)
    commands, program = simulation.commands, simulation.rollout.coils
    assert commands.send(CURRENTS, {"name": ["coil_5"], "effort": [40.0]}) == ""
    assert "clipped to 60 A" in commands.send(CURRENTS, {"name": ["coil_1"], "effort": [-99]})
    for message, error in (
        ({"name": ["coil_10"], "effort": [1.0]}, "Allowed: coil_1 to coil_9, each once"),
        ({"name": ["coil_1"] * 2, "effort": [1.0] * 2}, "each once"),
        ({"name": 5, "effort": []}, "name is 5"),
        ({"effort": [1.0]}, "Allowed: 9 currents"),
        ({"effort": [1.0] * 8 + ["x"]}, "effort is 'x'"),
    ):
        with pytest.raises(InputError, match=error):
            commands.send(CURRENTS, message)
    found = [m for m in messages(simulation, 0.1) if m.topic == "/coils/joint_states"]
    assert found[0].fields["effort"].tolist() == [0.0] * 9
    expected = CoilSteering((Currents(0.0, (-60.0, 0, 0, 0, 40.0, 0, 0, 0, 0)),))
    motion = replace(coil_scenario.motion, coils=expected)
    rollout = motion.begin(simulation.model, frames=2, fps=10.0, seed=0)
    *_, last = rollout.moments(None, lambda *_: None, lambda: False)
    np.testing.assert_array_equal(found[1].fields["effort"], last.command.coils.state.currents)
    assert program is not None and program.status.commands[4] == 40.0


def test_worlds_that_cannot_be_published_are_one_line(scenario):
    with pytest.raises(InputError, match="contains no magnet"):
        LiveSimulation(Scenario("stomach", "mirocam"))
    with pytest.raises(InputError, match="real_time_factor is -1"):
        LiveSimulation(scenario, real_time_factor=-1.0)
    with pytest.raises(InputError, match="does not fit; give that or less"):
        LiveSimulation(scenario, field_of_view=3.0)
