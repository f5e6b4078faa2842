"""Forward and inverse kinematics: pinocchio's Panda, and what the inverse must satisfy."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.flange_paths import loop_of, pose_errors
from tests.support.scenes import random_poses
from vrcaps.actuation.arm.arm import (
    Arm,
    arm_names,
    forward,
    frames,
    inverse,
    jacobian,
    nearest,
    read_arm,
)
from vrcaps.core.errors import InputError, UnknownNameError


def random_angles(arm: Arm, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(arm.lower, arm.upper, (count, arm.num_joints))


@pytest.fixture(scope="module")
def model():
    pinocchio = pytest.importorskip("pinocchio")
    share = Path(pinocchio.__file__).parents[4] / "share" / "example-robot-data" / "robots"
    file = share / "panda_description" / "urdf" / "panda.urdf"
    if not file.is_file():
        pytest.skip(f"no Panda from example-robot-data at {file}")
    model = pinocchio.buildModelFromUrdf(os.fspath(file))
    return pinocchio, model, model.createData(), model.getFrameId("panda_link8")


def test_forward_and_jacobian_are_pinocchios(panda, model):
    pinocchio, robot, data, flange = model
    angles = random_angles(panda, np.random.default_rng(0), 1000)
    poses, rows = forward(panda, angles), jacobian(panda, angles)
    world = pinocchio.LOCAL_WORLD_ALIGNED
    for q, pose, ours in zip(angles, poses, rows, strict=True):
        full = np.concatenate([q, np.zeros(robot.nq - 7)])
        theirs = pinocchio.computeFrameJacobian(robot, data, full, flange, world)[:, :7]
        pinocchio.framesForwardKinematics(robot, data, full)
        assert np.abs(pose - data.oMf[flange].homogeneous).max() < 1e-9
        assert np.abs(ours - theirs).max() < 1e-9


def test_limits_are_pinocchios(panda, model):
    robot = model[1]
    np.testing.assert_allclose(panda.lower, robot.lowerPositionLimit[:7])
    np.testing.assert_allclose(panda.upper, robot.upperPositionLimit[:7])
    np.testing.assert_allclose([j.velocity for j in panda.joints], robot.velocityLimit[:7])
    np.testing.assert_allclose([j.torque for j in panda.joints], robot.effortLimit[:7])


def test_jacobian_is_the_slope_of_the_pose(six_joints):
    angles = random_angles(six_joints, np.random.default_rng(1), 20)
    h = 1e-6
    rows = jacobian(six_joints, angles)
    for k in range(6):
        step = h * np.eye(6)[k]
        up, down = forward(six_joints, angles + step), forward(six_joints, angles - step)
        slope = (up - down) / (2 * h)
        np.testing.assert_allclose(rows[:, :3, k], slope[:, :3, 3], atol=1e-8)
        spin = slope[:, :3, :3] @ np.swapaxes(forward(six_joints, angles)[:, :3, :3], 1, 2)
        axis = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
        np.testing.assert_allclose(rows[:, 3:, k], axis, atol=1e-8)


def test_frames_end_in_the_flange(panda):
    angles = random_angles(panda, np.random.default_rng(2), 6).reshape(2, 3, 7)
    poses = frames(panda, angles)
    assert poses.shape == (2, 3, 8, 4, 4)
    assert np.array_equal(poses[..., -1, :, :], forward(panda, angles))
    np.testing.assert_allclose(poses[..., 0, :3, 3], np.broadcast_to([0, 0, 0.333], (2, 3, 3)))


def test_every_branch_lands_within_limits_and_none_is_missed(panda):
    angles = random_angles(panda, np.random.default_rng(3), 3000)
    targets = forward(panda, angles)
    counts = set()
    for q, target in zip(angles, targets, strict=True):
        found = inverse(panda, target, q[6])
        place, turn = pose_errors(panda, found, np.broadcast_to(target, (len(found), 4, 4)))
        assert place < 1e-9
        assert turn < 1e-9
        assert (found >= panda.lower).all()
        assert (found <= panda.upper).all()
        assert np.abs(found - q).max(axis=1).min() < 1e-6
        gaps = np.abs(found[:, None] - found[None]).max(axis=2) + 7 * np.eye(len(found))
        assert gaps.min() > 1e-9
        counts.add(len(found))
    assert counts == {1, 2, 3, 4, 5, 6, 7, 8}


def test_straight_shoulder_keeps_the_first_joint(panda):
    """With q2 = 0 only q1 + q3 counts: q1 stays as it was."""
    start = np.array([0.7, 0.0, -0.3, -1.5, 0.2, 1.8, 0.4])
    found = nearest(panda, forward(panda, start), start)
    np.testing.assert_allclose(found, start, atol=1e-6)


def test_nearest_lands_and_nearly_always_exists(panda):
    rng = np.random.default_rng(4)
    targets = forward(panda, random_angles(panda, rng, 5000))
    found = nearest(panda, targets, np.array(panda.home))
    solved = ~np.isnan(found).any(axis=1)
    assert solved.mean() >= 0.999
    place, turn = pose_errors(panda, found[solved], targets[solved])
    assert place < 1e-9
    assert turn < 1e-9


def test_nearest_is_mostly_the_nearest_of_a_dense_search(panda):
    """The grid of q7 can miss a narrow window; what is found then is a solution further off."""
    rng = np.random.default_rng(5)
    start = np.array(panda.home)
    worse = []
    for q in random_angles(panda, rng, 40):
        target = forward(panda, q)
        ours = np.linalg.norm(nearest(panda, target, start) - start)
        grid = np.linspace(panda.lower[6], panda.upper[6], 2000)
        all_found = panda.core.inverse(np.tile(target, (2000, 1, 1)), list(grid)).reshape(-1, 7)
        worse.append(ours - np.nanmin(np.linalg.norm(all_found - start, axis=1)))
    assert np.quantile(worse, 0.9) < 0.05
    assert np.median(worse) < 1e-3


def test_an_arm_that_is_there_stays(panda):
    angles = random_angles(panda, np.random.default_rng(6), 500)
    np.testing.assert_allclose(nearest(panda, forward(panda, angles), angles), angles, atol=1e-5)


def test_a_path_is_followed_without_a_jump(panda):
    """A closed path of 1,000 poses: steps as even as the path's, and no step of a step."""
    poses = loop_of(panda, 1000)
    angles = panda.core.follow(poses, np.array(panda.home))
    place, turn = pose_errors(panda, angles, poses)
    assert max(place, turn) < 1e-9
    steps = np.abs(np.diff(angles, axis=0))
    assert steps.max() < 0.012
    assert np.abs(np.diff(angles, n=2, axis=0)).max() < 5e-4


def test_the_arm_goes_through_a_straight_shoulder(panda):
    """With q2 at 0, q1 and q3 are free and would swing; q7 moves instead."""
    start = np.array([0.186, -0.004, 0.139, -2.229, 0.247, 2.273, 0.17])
    poses = np.tile(forward(panda, start), (100, 1, 1))
    poses[:, 1, 3] += np.linspace(0, 0.02, 100)
    angles = panda.core.follow(poses, start)
    assert angles[0, 1] < 0 < angles[-1, 1]
    assert np.abs(np.diff(angles, axis=0)).max() < 0.01


def test_no_jump_that_any_other_branch_would_avoid(panda):
    """Random ways, also along the edge of reach: each step is nearly the least there is."""
    rng = np.random.default_rng(9)
    middle, half = 0.5 * (panda.lower + panda.upper), 0.1 * (panda.upper - panda.lower)
    grid = np.linspace(panda.lower[6], panda.upper[6], 20001)
    s = np.linspace(0, 1, 300)[:, None]
    for start in rng.uniform(middle - half, middle + half, (40, 7)):
        way, spin = rng.normal(size=(2, 3))
        poses = np.tile(forward(panda, start), (300, 1, 1))
        poses[:, :3, 3] += 0.25 * s * way / np.linalg.norm(way)
        turns = Rotation.from_rotvec(0.8 * s * spin / np.linalg.norm(spin)).as_matrix()
        poses[:, :3, :3] = turns @ poses[:, :3, :3]
        angles = panda.core.follow(poses, start)
        angles = angles[~np.isnan(angles[:, 0])]
        steps = np.abs(np.diff(angles, axis=0)).max(axis=1, initial=0)
        if steps.max(initial=0) > 0.2:
            k = steps.argmax()
            targets = np.tile(poses[k + 1], (len(grid), 1, 1))
            others = panda.core.inverse(targets, list(grid)).reshape(-1, 7)
            assert steps[k] < 1.1 * np.nanmin(np.abs(others - angles[k]).max(axis=1)) + 0.02


def test_any_other_arm_is_solved_step_by_step(six_joints):
    rng = np.random.default_rng(7)
    angles = rng.uniform(-2.0, 2.0, (30, 6))
    targets = forward(six_joints, angles)
    found = nearest(six_joints, targets, angles + rng.normal(scale=0.2, size=angles.shape), rng=rng)
    solved = ~np.isnan(found).any(axis=1)
    assert solved.mean() > 0.9
    place, turn = pose_errors(six_joints, found[solved], targets[solved])
    assert max(place, turn) < 1e-9
    assert (np.abs(found[solved]) <= 6.2).all()
    far = np.eye(4)
    far[:3, 3] = [3.0, 0, 0]
    assert np.isnan(nearest(six_joints, far, np.array(six_joints.home))).all()


def test_out_of_reach_is_no_angles(panda):
    far = random_poses(np.random.default_rng(8), 5)
    far[:, :3, 3] = [1.5, 0, 0]
    assert np.isnan(nearest(panda, far, np.array(panda.home))).all()
    assert inverse(panda, far[0], 0.0).shape == (0, 7)
    assert inverse(panda, forward(panda, np.array(panda.home)), 3.0).shape == (0, 7)


def test_no_closed_form_says_what_to_use(panda, six_joints):
    assert panda.core.has_closed_form
    with pytest.raises(
        InputError, match=r"Arm six has no closed-form inverse kinematics.*Use nearest\(\)"
    ):
        inverse(six_joints, np.eye(4), 0.0)
    joints = (replace(panda.joints[0], a=0.1), *panda.joints[1:])
    assert not replace(panda, joints=joints).core.has_closed_form


def test_angles_and_poses_must_fit(panda):
    with pytest.raises(InputError, match=r"Angles for arm panda have shape \(6,\)\. Allowed: 7"):
        forward(panda, np.zeros(6))
    with pytest.raises(InputError, match=r"Angles for arm panda have shape \(7,\)"):
        forward(panda, np.full(7, np.nan))
    with pytest.raises(InputError, match=r"Poses have shape \(3, 3\)\. Allowed: finite 4 x 4"):
        nearest(panda, np.eye(3), np.array(panda.home))


@pytest.mark.parametrize("name", arm_names())
def test_every_arm_reads_and_rests_clear(name):
    arm = read_arm(name)
    assert arm.name == name
    assert arm.source
    assert np.isfinite(forward(arm, np.array(arm.home))).all()
    assert arm.core.clearance(np.array([arm.home]))[0, 0] > 0


def test_a_users_own_arm(six_joints: Arm):
    assert six_joints.name == "six"
    assert six_joints.num_joints == 6
    np.testing.assert_allclose(six_joints.joints[3].a, -0.3922)


LINK = "\n[[links]]\nframe = {}\nstart_mm = [0, 0, 0]\nend_mm = [0, 0, 100]\nradius_mm = 40\n"


MASS, NEXT = "[[masses]]\nframe = 2\n", "mass_kg = 1\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("a_mm = -425", "a_mm = true", "six.toml: joints[2].a_mm is True. Allowed: a number."),
        ("payload_kg = 5", "payload_kg = 0", "six.toml: payload is 0.0. Allowed: above 0"),
        ("title =", "subtitle =", "six.toml: unknown key subtitle. Allowed: name, title, joints"),
        ('title = "An arm of six joints"', "", "six.toml: missing key title: a string."),
        ("title =", 'name = "x"\ntitle =', "Unknown key six.toml: name. The name of an arm"),
        (
            "upper_rad = 6.2",
            "upper_rad = -7",
            "joints[0]: upper is -7. Allowed: above lower, -6.2 rad.",
        ),
        ("torque_nm = 150", "torque_nm = 0", "joints[0]: torque is 0.0. Allowed: above 0"),
        ("home_deg = [0, -90,", "home_deg = [-90,", "6 joints, but 5 home angles."),
        ("home_deg = [0,", "home_deg = [360,", "home angle of joint 1 is outside its limits."),
        (
            "home_deg",
            "collision_pairs = [[0, 8]]\nhome_deg",
            "names frame 8 or 0. Allowed: 0 (base) to 7",
        ),
        (
            "home_deg",
            "collision_pairs = [[0]]\nhome_deg",
            "collision_pairs[0] has 1 values. Allowed: 2.",
        ),
        (
            "theta_deg = 0",
            "theta_deg = 0\nweight = 1",
            "six.toml: unknown key joints[0].weight. Allowed: a_mm, d_mm",
        ),
        ("title", "title = ", "is not TOML"),
        (
            "[[joints]]",
            f"{MASS}mass_kg = 1e7\n[[joints]]",
            "masses[0]: mass is 10000000.0. Allowed: above 0",
        ),
        (
            "[[joints]]",
            f"{MASS}mass_kg = 1\ncenter_mm = [1e10, 0, 0]\n[[joints]]",
            "masses[0]: center is (10000000.0, 0.0, 0.0). Allowed: numbers from -1e+06 to 1e+06",
        ),
        (
            "[[joints]]",
            f"{MASS}mass_kg = 0\n[[joints]]",
            "masses[0]: mass is 0.0. Allowed: above 0 to 1000000.",
        ),
        (
            "[[joints]]",
            f"{MASS}mass_kg = 1\ninertia_kg_m2 = [1, 1, 3, 0, 0, 0]\n[[joints]]",
            "masses[0]: inertia is (1.0, 1.0, 3.0, 0.0, 0.0, 0.0). Allowed: positive, and no",
        ),
        ("[[joints]]", f"{2 * (MASS + NEXT)}[[joints]]", "a frame has two masses. Allowed: one"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, six_joints_text, old, new, message):
    assert old in six_joints_text
    path = tmp_path / "six.toml"
    path.write_text(
        six_joints_text.replace(old, new, -1 if "mass" not in new else 1) + LINK.format(1)
    )
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_arm(path)
    assert "\n" not in str(caught.value)


def test_a_link_needs_a_frame(tmp_path, six_joints_text):
    path = tmp_path / "six.toml"
    path.write_text(six_joints_text + LINK.format(-1))
    with pytest.raises(InputError, match=r"links\[0\]: frame is -1. Allowed: 0 or more"):
        read_arm(path)


def test_unknown_arms(tmp_path):
    with pytest.raises(UnknownNameError, match=r"No arm named 'pandas'\. Known: panda"):
        read_arm("pandas")
    with pytest.raises(
        InputError, match=r"No arm file at .*none\.toml\. Give a TOML file, or one of"
    ):
        read_arm(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="is not TOML"):
        read_arm(tmp_path / "bytes.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="No arm file at"):
        read_arm(tmp_path / "folder.toml")
