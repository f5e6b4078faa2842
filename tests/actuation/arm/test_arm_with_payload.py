"""An arm with a magnet: where it holds it, what it refuses, what it touches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.scenes import random_poses
from vrcaps.actuation.arm.arm import Arm, forward, frames, nearest, read_arm
from vrcaps.actuation.arm.arm_with_payload import (
    ArmWithPayload,
    check_speed,
    clearances,
    flange_pose_at,
    follow,
    limit_utilization,
    magnet_pose_at,
    reachability,
    solve_joint_angles,
)
from vrcaps.actuation.arm.chain import Link
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import magnet_pose

DOWN = (0.0, 0.0, -1.0)


@pytest.fixture(scope="module")
def robot(panda: Arm) -> ArmWithPayload:
    base = np.eye(4)
    base[:3, 3] = [-0.5, 0.1, 0.8]
    return ArmWithPayload(panda, read_magnet("cylinder-101.6"), base, table_height=0.8)


def test_reach_holds_the_magnet_there(robot):
    target = magnet_pose((0.0, 0.2, 1.1), (0.3, 0.1, -1.0))
    angles = solve_joint_angles(robot, target)
    np.testing.assert_allclose(magnet_pose_at(robot, angles), target, atol=1e-9)
    flange = forward(robot.arm, angles)
    np.testing.assert_allclose(flange_pose_at(robot, target), flange, atol=1e-9)
    assert clearances(robot, angles[None]).min() > 0


def test_default_mount_is_along_the_flange(robot, panda):
    np.testing.assert_allclose(robot.mount[:3, 3], [0, 0, 0.03 + 0.0508])
    own = np.eye(4)
    own[0, 3] = 0.2
    moved = replace(robot, T_flange_magnet=own)
    home = np.array(panda.home)
    expected = robot.T_world_base @ forward(panda, home) @ own
    np.testing.assert_allclose(magnet_pose_at(moved, home), expected)


def test_magnet_in_the_table(robot):
    with pytest.raises(
        InputError, match=r"The magnet would penetrate the table by 40\.8 mm\. Allowed: its"
    ):
        solve_joint_angles(robot, magnet_pose((0, 0.1, 0.81), DOWN))


def test_magnet_out_of_reach(robot):
    with pytest.raises(
        InputError,
        match=r"Arm panda does not reach a magnet at \[1\.\s+0\.1 1\.\s+\] .*\(arm_base\)",
    ):
        solve_joint_angles(robot, magnet_pose((1.0, 0.1, 1.0), DOWN))


def test_arm_without_a_closed_form_restarts_where_home_leads_nowhere():
    robot = ArmWithPayload(read_arm("ur5e"), read_magnet("cylinder-76.2"))
    home = np.array(robot.arm.home)
    turns = np.random.default_rng(1).uniform(-2.8, 2.8, (60, 6))
    turns = turns[clearances(robot, turns).min(axis=1) > 0.0]
    flanges = forward(robot.arm, turns)
    lost = turns[np.isnan(nearest(robot.arm, flanges, home)).any(axis=1)]
    assert len(lost) > 0
    target = magnet_pose_at(robot, lost[0])
    angles = solve_joint_angles(robot, target)
    np.testing.assert_allclose(magnet_pose_at(robot, angles), target, atol=1e-6)
    np.testing.assert_array_equal(solve_joint_angles(robot, target), angles)


def test_pose_must_be_rigid(robot):
    with pytest.raises(InputError, match=r"T_world_magnet is not a rigid pose"):
        solve_joint_angles(robot, 2 * np.eye(4))
    with pytest.raises(InputError, match=r"T_world_base is not a rigid pose"):
        replace(robot, T_world_base=np.zeros((4, 4)))
    with pytest.raises(InputError, match=r"T_flange_magnet is not a rigid pose"):
        replace(robot, T_flange_magnet=np.zeros((4, 4)))


def test_arm_that_touches_the_table(robot, panda):
    """The hand is lowered until the wrist's links would be in the table."""
    free = replace(robot, table_height=None)
    target = magnet_pose((0.0, 0.1, 0.95), (0.0, 0.0, 1.0))
    angles = solve_joint_angles(free, target)
    assert clearances(robot, angles[None])[0, 1] < 0
    with pytest.raises(InputError, match=r"Pose 0: arm panda penetrates the table by .* mm"):
        solve_joint_angles(robot, target)


def test_arm_that_touches_itself(robot):
    folded = np.array([0.0, -0.5, 0.0, -3.05, 0.0, 0.02, 0.0])
    assert clearances(replace(robot, table_height=None), folded[None])[0, 0] < 0
    with pytest.raises(InputError, match=r"arm panda penetrates itself"):
        target = magnet_pose_at(robot, folded)
        solve_joint_angles(replace(robot, table_height=None), target, near=folded)


@pytest.mark.slow
def test_clearance_is_that_of_dense_points(robot, panda):
    """Capsules' distances against the nearest of many points on their middle lines."""
    rng = np.random.default_rng(0)
    arm = robot.loaded_arm
    table = np.linspace(0, 1, 201)[:, None]
    for q in rng.uniform(arm.lower, arm.upper, (20, 7)):
        poses = np.concatenate([np.eye(4)[None], frames(panda, q)])
        lines = [
            transform_points(poses[k.frame], (1 - table) * k.start + table * k.end)
            for k in arm.links
        ]
        gaps = [
            np.linalg.norm(lines[i][:, None] - lines[j][None], axis=-1).min() - a.radius - b.radius
            for i, a in enumerate(arm.links)
            for j, b in enumerate(arm.links)
            if (a.frame, b.frame) in arm.collision_pairs
        ]
        own = clearances(replace(robot, table_height=None), q[None])[0, 0]
        assert min(gaps) - 2e-3 < own <= min(gaps) + 1e-12


def test_points_and_parallel_lines_have_distances(panda):
    """Capsules of no length, and side by side."""
    home = np.array(panda.home)
    for one, other, gap in (
        (((0, 0, 0), (0, 0, 0)), ((0, 0, 0.5), (0, 0, 0.5)), 0.5),
        (((0, 0, 0), (1, 0, 0)), ((2, 0.3, 0), (0.5, 0.3, 0)), 0.3),
        (((0, 0, 0), (1, 0, 0)), ((2, 0, 0), (3, 0, 0)), 1.0),
        (((0, 0, 0), (1, 0, 0)), ((0.4, 0.2, -1), (0.4, 0.2, 1)), 0.2),
        (((0, 0, 0), (0, 0, 0)), ((-1, 0.4, 0), (1, 0.4, 0)), 0.4),
    ):
        links = (Link(0, *one, 0.01), Link(0, *other, 0.02))
        arm = replace(panda, links=links, collision_pairs=((0, 0),))
        assert arm.core.clearance(home[None])[0, 0] <= 0  # a capsule touches itself
        pair = replace(arm, links=(links[0], replace(links[1], frame=1)), collision_pairs=((0, 1),))
        shift = np.array([0, 0, -0.333])
        low = Link(1, tuple(np.add(other[0], shift)), tuple(np.add(other[1], shift)), 0.02)
        pair = replace(pair, links=(links[0], low))
        clear = pair.core.clearance(np.zeros((1, 7)))[0, 0]
        np.testing.assert_allclose(clear, gap - 0.03, atol=1e-12)


def test_a_tilted_cylinders_lowest_point(robot, panda):
    """Against points on its rim."""
    rng = np.random.default_rng(1)
    rim = np.linspace(0, 2 * np.pi, 4001)
    for q in rng.uniform(panda.lower, panda.upper, (20, 7)):
        pose = magnet_pose_at(robot, q)
        circle = [0.0508 * np.cos(rim), 0.0508 * np.sin(rim), 0 * rim + 0.0508]
        both = np.concatenate([np.stack(circle, -1), np.stack(circle, -1) * [1, 1, -1]])
        lowest = transform_points(pose, both)[:, 2].min() - 0.8
        links = panda.core.clearance(q[None], ((0, 0, 0.0), (0, 0, 1.0)))[0, 1]
        got = clearances(robot, q[None])[0, 1]
        np.testing.assert_allclose(got, min(lowest, links), atol=1e-6)


def path(count: int) -> np.ndarray:
    s = np.linspace(0, 1, count)
    return np.array([magnet_pose((0.0, 0.1 + 0.2 * x, 1.1), (0.2 * x, 0.0, -1.0)) for x in s])


def test_follow_leads_the_magnet(robot):
    poses = path(200)
    start = solve_joint_angles(robot, poses[0])
    angles = follow(robot, poses, start, dt=0.02)
    np.testing.assert_allclose(magnet_pose_at(robot, angles), poses, atol=1e-9)
    assert np.abs(np.diff(angles, axis=0)).max() < 0.02


def test_follow_says_when_it_is_too_fast(robot):
    poses = path(5)
    start = solve_joint_angles(robot, poses[0])
    with pytest.raises(
        InputError, match=r"Step \d: joint \d of arm panda would turn at .* rad/s\."
    ):
        follow(robot, poses, start, dt=0.01)


def test_follow_says_where_it_ends(robot):
    poses = path(10)
    poses[6:, 0, 3] += 2.0
    with pytest.raises(InputError, match=r"Pose 6 of 10 is out of reach of arm panda"):
        follow(robot, poses, solve_joint_angles(robot, poses[0]), dt=1.0)


def test_follow_says_what_it_touches(robot):
    poses = path(10)
    poses[4:, 2, 3] = 0.82
    with pytest.raises(InputError, match=r"Pose \d: arm panda penetrates the table"):
        follow(robot, poses, solve_joint_angles(robot, poses[0]), dt=1.0)


def test_another_arm_follows_too(six_joints):
    held = ArmWithPayload(six_joints, read_magnet("cylinder-50.8"))
    start = np.array(six_joints.home)
    poses = np.tile(magnet_pose_at(held, start), (20, 1, 1))
    poses[:, 1, 3] += np.linspace(0, 0.05, 20)
    angles = follow(held, poses, start, dt=0.05)
    np.testing.assert_allclose(magnet_pose_at(held, angles), poses, atol=1e-9)
    poses[10:, 0, 3] = 4.0
    with pytest.raises(InputError, match=r"Pose 10 of 20 is out of reach of arm six"):
        follow(held, poses, start, dt=0.05)


def test_speed_needs_a_time(panda):
    with pytest.raises(InputError, match=r"dt is 0\. Allowed: above 0 s\."):
        check_speed(panda, np.zeros((2, 7)), 0)
    check_speed(panda, np.zeros((1, 7)), 1.0)


def test_parts_of_limits_are_those_of_the_motion(panda):
    """q = A sin ωt: speed A ω, acceleration A ω², jerk A ω³."""
    t = np.arange(0, 2.5, 1e-3)[:, None]
    size, omega = 0.1 * np.arange(1, 8), 3.0
    parts = limit_utilization(panda, size * np.sin(omega * t), 1e-3)
    for n, name in enumerate(("velocity", "acceleration", "jerk")):
        limits = np.array([getattr(joint, name) for joint in panda.joints])
        np.testing.assert_allclose(parts[n], size * omega ** (n + 1) / limits, rtol=1e-4)
    with pytest.raises(InputError, match=r"not defined for 3 angles\. Allowed: 4 or more"):
        limit_utilization(panda, np.zeros((3, 7)), 0.1)
    with pytest.raises(InputError, match=r"dt is -1\. Allowed: above 0 s\."):
        limit_utilization(panda, np.zeros((4, 7)), -1)


def test_load_is_the_magnets_weight(panda):
    """The 4 inch cylinder is twice what a Panda may carry, the 3 inch one is within it."""
    np.testing.assert_allclose(
        ArmWithPayload(panda, read_magnet("cylinder-101.6")).payload_ratio, 2.06, atol=0.01
    )
    assert ArmWithPayload(panda, read_magnet("cylinder-76.2")).payload_ratio < 0.9
    heavy, light = (
        ArmWithPayload(panda, read_magnet(f"cylinder-{size}")) for size in (101.6, 76.2)
    )
    assert heavy.overload_note.startswith("The magnet weighs 6.2 kg, but arm panda may carry 3 kg")
    assert light.overload_note == ""


def test_reachability_map(robot):
    """Near the front most downward magnets are reached, far away none, in the table none."""
    rng = np.random.default_rng(2)
    tilted = random_poses(rng, 1)[0]
    places = [(0.05, 0.1, 1.1), (2.0, 0.1, 1.1), (0.05, 0.1, 0.7)]
    poses = np.array([[magnet_pose(p, d) for d in (DOWN, (0.2, 0, -1))] for p in places])
    found = reachability(robot, poses)
    np.testing.assert_array_equal(found, [[1, 1], [0, 0], [0, 0]])
    tilted[:3, 3] = [9.0, 0.0, 0.0]
    assert reachability(robot, tilted) == 0
