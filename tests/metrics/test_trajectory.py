"""Trajectory errors against closed forms and SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import invert, transform_from
from vrcaps.metrics.simcol3d import score_poses
from vrcaps.metrics.trajectory import (
    Similarity,
    absolute_trajectory_error,
    fit_similarity,
    relative_pose_error,
    rotation_angle,
)


def _poses(seed=0, count=30):
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.1, (count, 3)), axis=0))
    return transform_from(rotation.as_matrix(), np.cumsum(rng.normal(0.0, 2e-3, (count, 3)), 0))


def _similarity(scale=1.0):
    rotation = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    return Similarity(rotation, np.array([0.1, -0.2, 0.3]), scale)


@pytest.mark.parametrize(("align", "scale"), [("se3", 1.0), ("sim3", 0.37)])
def test_alignment_takes_a_similarity_away(align, scale):
    truth = _poses()
    moved = _similarity(scale).poses(truth)
    assert absolute_trajectory_error(moved, truth, align=align).max() < 1e-12
    assert absolute_trajectory_error(moved, truth, align="none").max() > 0.01


def test_scale_is_left_by_a_rigid_alignment():
    truth = _poses()
    found = absolute_trajectory_error(_similarity(1.1).poses(truth), truth, align="se3")
    offsets = truth[:, :3, 3] - truth[:, :3, 3].mean(axis=0)
    np.testing.assert_allclose(found, 0.1 * np.linalg.norm(offsets, axis=1), rtol=1e-9)


def test_mirrored_points_are_not_turned_into_a_reflection():
    points = np.random.default_rng(3).normal(size=(20, 3))
    found = fit_similarity(points, points * [1.0, 1.0, -1.0], scale=True)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_rotation_of_the_fit_is_that_of_scipy():
    rng = np.random.default_rng(4)
    source, target = rng.normal(size=(25, 3)), rng.normal(size=(25, 3))
    found = fit_similarity(source, target, scale=False)
    oracle = Rotation.align_vectors(target - target.mean(0), source - source.mean(0))[0]
    np.testing.assert_allclose(found.rotation, oracle.as_matrix(), atol=1e-9)


def test_relative_errors_do_not_depend_on_the_frame_and_see_one_wrong_step():
    truth = _poses()
    moved = _similarity().poses(truth)
    found = relative_pose_error(moved, truth)
    assert found.translation.max() < 1e-12
    assert found.rotation.max() < 1e-6
    step = transform_from(Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix(), [3e-3, 0.0, 0.0])
    moved[10:] = moved[9] @ step @ invert(moved[9]) @ moved[10:]
    found = relative_pose_error(moved, truth)
    assert np.flatnonzero(found.rotation > 1e-6).tolist() == [9]
    assert found.rotation[9] == pytest.approx(0.2)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi])
def test_angle_of_a_rotation_is_exact(angle):
    rotation = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    assert rotation_angle(rotation) == pytest.approx(angle, rel=1e-6, abs=1e-15)


def test_challenge_score_is_zero_for_scaled_truth_and_finds_the_scale():
    truth = _poses()
    relative = invert(truth[:-1]) @ truth[1:]
    relative[:, :3, 3] *= 4.0
    score = score_poses(relative, truth)
    assert score.scale == pytest.approx(0.25)
    assert max(score.ate, score.rte, score.rot) < 1e-7


def test_bad_input_is_one_clear_line():
    poses = _poses()
    with pytest.raises(InputError, match=r"estimate has the shape \(29, 4, 4\)"):
        absolute_trajectory_error(poses[1:], poses)
    with pytest.raises(UnknownNameError, match="alignment of a trajectory"):
        absolute_trajectory_error(poses, poses, align="affine")  # type: ignore[arg-type]
    line = transform_from(np.eye(3), np.linspace(0, 1, 5)[:, None] * [1.0, 0.0, 0.0])
    with pytest.raises(InputError, match="collinear"):
        absolute_trajectory_error(line, line)
    with pytest.raises(InputError, match="delta of relative poses is 30"):
        relative_pose_error(poses, poses, delta=30)
