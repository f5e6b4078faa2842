"""Magnet actuators keep their limits, arrive, and never jump."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support import robot_actuator_twin
from vrcaps.actuation.arm.arm import read_arm
from vrcaps.actuation.arm.arm_with_payload import (
    ArmWithPayload,
    limit_utilization,
    magnet_pose_at,
    transverse_mount,
)
from vrcaps.actuation.magnet_actuator import FreeActuator, RobotActuator, stopping_speed
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotate_by_vector, vector_from_rotation
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import magnet_pose

DT = 0.01


@pytest.fixture(scope="module")
def arm() -> RobotActuator:
    magnet = read_magnet("cylinder-76.2")
    base = np.eye(4)
    base[:3, 3] = (-0.55, 0.0, -0.2)
    workspace = Workspace(low=(-1.0, -1.0, 0.05), high=(1.0, 1.0, 1.0))
    return RobotActuator(
        ArmWithPayload(read_arm("panda"), magnet, base, transverse_mount(magnet)), workspace
    )


def test_turns_are_rotations():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-7, np.pi):
        axis = rng.normal(size=3)
        vector = size * axis / np.linalg.norm(axis)
        exact = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(rotate_by_vector(vector, np.eye(3)), exact, atol=1e-12)
        np.testing.assert_allclose(
            Rotation.from_rotvec(vector_from_rotation(exact)).as_matrix(), exact, atol=1e-7
        )


def test_a_free_magnet_arrives_within_its_limits():
    actuator = FreeActuator()
    state = actuator.start(magnet_pose((0, 0, 0.2), (0, 0, 1)))
    target = magnet_pose((0.1, -0.05, 0.3), (1, 1, -1))
    places, speeds = [state.T_world_magnet], [state.velocity]
    for _ in range(300):
        state = actuator.move(state, target, DT)
        places.append(state.T_world_magnet)
        speeds.append(state.velocity)
    velocity = np.array(speeds)
    assert np.linalg.norm(velocity[:, :3], axis=1).max() <= actuator.max_speed + 1e-12
    assert np.linalg.norm(velocity[:, 3:], axis=1).max() <= actuator.max_angular_speed + 1e-12
    change = np.linalg.norm(np.diff(velocity[:, :3], axis=0), axis=1)
    assert change.max() <= actuator.max_acceleration * DT + 1e-12
    steps = np.diff(np.array(places)[:, :3, 3], axis=0)
    np.testing.assert_allclose(steps, DT * velocity[1:, :3], atol=1e-15)
    np.testing.assert_allclose(state.T_world_magnet, target, atol=1e-6)
    assert state.limit == ""


def test_stopping_speed_stops_in_time():
    """v dt + v²/2a = way."""
    for way in (1e-6, 1e-3, 0.1):
        v = stopping_speed(way, 2.0, DT)
        assert v * DT + v * v / 4.0 == pytest.approx(way)


def test_an_arm_arrives_within_its_limits(arm):
    state = arm.start(magnet_pose((0, 0, 0.2), (1, 0, 0)))
    target = magnet_pose((0.05, 0.1, 0.25), (1, 0.5, -0.2))
    angles, limits = [state.joint_angles] * 3, set()
    for _ in range(300):
        state = arm.move(state, target, DT)
        angles.append(state.joint_angles)
        limits.add(state.limit)
    assert limit_utilization(arm.robot.arm, np.array(angles), DT).max() <= 1.0 + 1e-6
    np.testing.assert_allclose(state.T_world_magnet[:3, 3], target[:3, 3], atol=1e-4)
    np.testing.assert_allclose(state.T_world_magnet[:3, 2], target[:3, 2], atol=1e-3)
    np.testing.assert_allclose(state.T_world_magnet, magnet_pose_at(arm.robot, state.joint_angles))
    assert limits <= {"", "speed"}


def test_an_arm_asked_for_the_impossible_stops_and_says_so(arm):
    start = arm.start(magnet_pose((0, 0, 0.2), (1, 0, 0)))
    for target, limit in (
        (magnet_pose((3.0, 0, 0.2), (1, 0, 0)), "unreachable"),
        (magnet_pose((-0.5, 0.0, 0.1), (1, 0, 0)), None),
        (magnet_pose((0, 0, -0.3), (1, 0, 0)), "workspace"),
    ):
        state, angles, limits = start, [start.joint_angles] * 3, []
        for _ in range(500):
            state = arm.move(state, target, DT)
            angles.append(state.joint_angles)
            limits.append(state.limit)
        assert np.isfinite(state.T_world_magnet).all()
        assert limit_utilization(arm.robot.arm, np.array(angles), DT).max() <= 1.0 + 1e-6
        assert np.all(state.joint_angles >= arm.robot.arm.lower)
        assert np.all(state.joint_angles <= arm.robot.arm.upper)
        assert limit in (None, limits[-1])
        assert state.T_world_magnet[2, 3] >= 0.05 - 1e-6
    assert np.abs(state.velocity).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("table", "low"), [(None, 0.05), (0.0, -0.1)])
def test_an_arm_moves_as_its_twin(arm, table, low):
    """From where the core led it, towards random targets: in reach, out of reach, in the table."""
    rng = np.random.default_rng(3)
    workspace = replace(arm.workspace, low=(-1.0, -1.0, low))
    actuator = replace(arm, robot=replace(arm.robot, table_height=table), workspace=workspace)
    place, axis = np.array([0.0, 0.0, low + 0.17]), np.array([1.0, 0.0, 0.0])
    start, limits, helped = actuator.start(magnet_pose(place, axis)), set(), 0
    for far in [0.1, 0.3, 1.0] * 2:
        target = magnet_pose(place + far * rng.normal(size=3), axis + rng.normal(size=3))
        state = start
        for _ in range(100):
            once = robot_actuator_twin.step(actuator, state, target, DT)
            theirs = robot_actuator_twin.move(actuator, state, target, DT)
            helped += once.limit == "unreachable" != theirs.limit
            state = actuator.move(state, target, DT)
            assert state.limit == theirs.limit
            for name in ("T_world_magnet", "velocity", "joint_angles"):
                # The last steps along the arm's self-motion end at a rounding's discretion.
                np.testing.assert_allclose(getattr(state, name), getattr(theirs, name), atol=1e-6)
            limits |= {once.limit, state.limit}
    assert helped > 0  # by a pose on the way where the one ahead is out of reach
    assert limits == {"", "speed", "workspace", "unreachable"} | (
        {"collision"} if low < 0.0 else set()
    )


def test_another_arm_holds_a_magnet_too(arm, six_joints):
    """Without a closed form the inverse is found step by step, from where the arm is."""
    base = np.eye(4)
    base[:3, 3] = (-0.5, 0.0, -0.1)
    actuator = replace(arm, robot=replace(arm.robot, arm=six_joints, T_world_base=base))
    state = actuator.start(
        magnet_pose((0, 0, 0.25), (0, 1, 0)), np.array([0, -1.5, 1.8, -2, -1.5, 0])
    )
    target = magnet_pose((0.05, 0.1, 0.3), (0.2, 1, -0.2))
    for _ in range(300):
        theirs = robot_actuator_twin.move(actuator, state, target, DT)
        state = actuator.move(state, target, DT)
        np.testing.assert_allclose(state.joint_angles, theirs.joint_angles, atol=1e-8)
    np.testing.assert_allclose(state.T_world_magnet[:3, 3], target[:3, 3], atol=1e-4)


def test_what_cannot_be(arm):
    with pytest.raises(InputError, match="FreeActuator's max_speed is 0"):
        FreeActuator(max_speed=0.0)
    with pytest.raises(InputError, match="The magnet's position is"):
        FreeActuator(Workspace(low=(0, 0, 1), high=(1, 1, 2))).start(np.eye(4))
    with pytest.raises(InputError, match="does not reach"):
        arm.start(magnet_pose((3.0, 0, 0.2), (1, 0, 0)))
    state = arm.start(magnet_pose((0, 0, 0.2), (1, 0, 0)))
    with pytest.raises(InputError, match=r"The state has 3 joints, for arm panda\. Allowed: 7"):
        arm.move(replace(state, joint_angles=np.zeros(3)), state.T_world_magnet, DT)
    nowhere = arm.move(state, np.full((4, 4), np.nan), DT)
    assert nowhere.limit == "unreachable"
    np.testing.assert_array_equal(nowhere.joint_angles, state.joint_angles)
