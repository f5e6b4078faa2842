"""What holds a magnet keeps its limits, arrives, and never jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import holder_twin
from vrcaps.actuation.arm.arm_catalog import load_arm
from vrcaps.actuation.arm.arm_with_payload import Carrier, across_mount, magnet_at, parts_of_limits
from vrcaps.actuation.magnet_actuator import FreeHolder, stopping_speed
from vrcaps.actuation.magnet_pose_solver import Room
from vrcaps.actuation.robot_actuator import ArmHolder
from vrcaps.actuation.vectors import rotation_vector, turned
from vrcaps.errors import InputError
from vrcaps.magnet.presets import load_magnet
from vrcaps.magnet.sources import magnet_pose

DT = 0.01


@pytest.fixture(scope="module")
def arm() -> ArmHolder:
    magnet = load_magnet("cylinder-76.2")
    base = np.eye(4)
    base[:3, 3] = (-0.55, 0.0, -0.2)
    room = Room(low=(-1.0, -1.0, 0.05), high=(1.0, 1.0, 1.0))
    return ArmHolder(Carrier(load_arm("panda"), magnet, base, across_mount(magnet)), room)


def test_turns_are_rotations():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-7, np.pi):
        axis = rng.normal(size=3)
        vector = size * axis / np.linalg.norm(axis)
        exact = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(turned(vector, np.eye(3)), exact, atol=1e-12)
        np.testing.assert_allclose(
            Rotation.from_rotvec(rotation_vector(exact)).as_matrix(), exact, atol=1e-7
        )


def test_a_free_magnet_arrives_within_its_limits():
    holder = FreeHolder()
    held = holder.start(magnet_pose((0, 0, 0.2), (0, 0, 1)))
    goal = magnet_pose((0.1, -0.05, 0.3), (1, 1, -1))
    places, speeds = [held.T_world_magnet], [held.velocity]
    for _ in range(300):
        held = holder.move(held, goal, DT)
        places.append(held.T_world_magnet)
        speeds.append(held.velocity)
    velocity = np.array(speeds)
    assert np.linalg.norm(velocity[:, :3], axis=1).max() <= holder.speed + 1e-12
    assert np.linalg.norm(velocity[:, 3:], axis=1).max() <= holder.turn_speed + 1e-12
    change = np.linalg.norm(np.diff(velocity[:, :3], axis=0), axis=1)
    assert change.max() <= holder.acceleration * DT + 1e-12
    steps = np.diff(np.array(places)[:, :3, 3], axis=0)
    np.testing.assert_allclose(steps, DT * velocity[1:, :3], atol=1e-15)
    np.testing.assert_allclose(held.T_world_magnet, goal, atol=1e-6)
    assert held.limit == ""


def test_stopping_speed_stops_in_time():
    """v dt + v²/2a = way."""
    for way in (1e-6, 1e-3, 0.1):
        v = stopping_speed(way, 2.0, DT)
        assert v * DT + v * v / 4.0 == pytest.approx(way)


def test_an_arm_arrives_within_its_limits(arm):
    held = arm.start(magnet_pose((0, 0, 0.2), (1, 0, 0)))
    goal = magnet_pose((0.05, 0.1, 0.25), (1, 0.5, -0.2))
    angles, limits = [held.angles] * 3, set()
    for _ in range(300):
        held = arm.move(held, goal, DT)
        angles.append(held.angles)
        limits.add(held.limit)
    assert parts_of_limits(arm.carrier.arm, np.array(angles), DT).max() <= 1.0 + 1e-6
    np.testing.assert_allclose(held.T_world_magnet[:3, 3], goal[:3, 3], atol=1e-4)
    np.testing.assert_allclose(held.T_world_magnet[:3, 2], goal[:3, 2], atol=1e-3)
    np.testing.assert_allclose(held.T_world_magnet, magnet_at(arm.carrier, held.angles))
    assert limits <= {"", "speed"}


def test_an_arm_asked_for_the_impossible_stops_and_says_so(arm):
    start = arm.start(magnet_pose((0, 0, 0.2), (1, 0, 0)))
    for goal, limit in (
        (magnet_pose((3.0, 0, 0.2), (1, 0, 0)), "reach"),
        (magnet_pose((-0.5, 0.0, 0.1), (1, 0, 0)), None),
        (magnet_pose((0, 0, -0.3), (1, 0, 0)), "room"),
    ):
        held, angles, limits = start, [start.angles] * 3, []
        for _ in range(500):
            held = arm.move(held, goal, DT)
            angles.append(held.angles)
            limits.append(held.limit)
        assert np.isfinite(held.T_world_magnet).all()
        assert parts_of_limits(arm.carrier.arm, np.array(angles), DT).max() <= 1.0 + 1e-6
        assert np.all(held.angles >= arm.carrier.arm.lower)
        assert np.all(held.angles <= arm.carrier.arm.upper)
        assert limit in (None, limits[-1])
        assert held.T_world_magnet[2, 3] >= 0.05 - 1e-6
    assert np.abs(held.velocity).max() < 1e-3


@pytest.mark.parametrize(("table", "low"), [(None, 0.05), (0.0, -0.1)])
def test_an_arm_moves_as_its_twin(arm, table, low):
    """From where the core led it, towards random goals: in reach, out of reach, in the table."""
    rng = np.random.default_rng(3)
    room = replace(arm.room, low=(-1.0, -1.0, low))
    holder = replace(arm, carrier=replace(arm.carrier, table_height=table), room=room)
    place, axis = np.array([0.0, 0.0, low + 0.17]), np.array([1.0, 0.0, 0.0])
    start, limits, helped = holder.start(magnet_pose(place, axis)), set(), 0
    for far in [0.1, 0.3, 1.0] * 6:
        goal = magnet_pose(place + far * rng.normal(size=3), axis + rng.normal(size=3))
        held = start
        for _ in range(100):
            once = holder_twin.step(holder, held, goal, DT)
            theirs = holder_twin.move(holder, held, goal, DT)
            helped += once.limit == "reach" != theirs.limit
            held = holder.move(held, goal, DT)
            assert held.limit == theirs.limit
            for name in ("T_world_magnet", "velocity", "angles"):
                # The last steps along the arm's self-motion end at a rounding's discretion.
                np.testing.assert_allclose(getattr(held, name), getattr(theirs, name), atol=1e-6)
            limits |= {once.limit, held.limit}
    assert helped > 0  # by a pose on the way where the one ahead is out of reach
    assert limits == {"", "speed", "room", "reach"} | ({"touch"} if low < 0.0 else set())


def test_another_arm_holds_a_magnet_too(arm, six_joints):
    """Without a closed form the inverse is found step by step, from where the arm is."""
    base = np.eye(4)
    base[:3, 3] = (-0.5, 0.0, -0.1)
    holder = replace(arm, carrier=replace(arm.carrier, arm=six_joints, T_world_base=base))
    held = holder.start(magnet_pose((0, 0, 0.25), (0, 1, 0)), np.array([0, -1.5, 1.8, -2, -1.5, 0]))
    goal = magnet_pose((0.05, 0.1, 0.3), (0.2, 1, -0.2))
    for _ in range(300):
        theirs = holder_twin.move(holder, held, goal, DT)
        held = holder.move(held, goal, DT)
        np.testing.assert_allclose(held.angles, theirs.angles, atol=1e-8)
    np.testing.assert_allclose(held.T_world_magnet[:3, 3], goal[:3, 3], atol=1e-4)


def test_what_cannot_be(arm):
    with pytest.raises(InputError, match="FreeHolder's speed is 0"):
        FreeHolder(speed=0.0)
    with pytest.raises(InputError, match="The magnet's place is"):
        FreeHolder(Room(low=(0, 0, 1), high=(1, 1, 2))).start(np.eye(4))
    with pytest.raises(InputError, match="does not reach"):
        arm.start(magnet_pose((3.0, 0, 0.2), (1, 0, 0)))
    held = arm.start(magnet_pose((0, 0, 0.2), (1, 0, 0)))
    with pytest.raises(InputError, match=r"held by 3 joints for arm panda\. Allowed: 7"):
        arm.move(replace(held, angles=np.zeros(3)), held.T_world_magnet, DT)
    nowhere = arm.move(held, np.full((4, 4), np.nan), DT)
    assert nowhere.limit == "reach"
    np.testing.assert_array_equal(nowhere.angles, held.angles)
