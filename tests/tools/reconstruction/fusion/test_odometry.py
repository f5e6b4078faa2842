"""Odometry: motions with wrong matches, many poses at once, and a run through an ellipsoid."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.ellipsoid_sequence import blanked, spotted_sequence
from vrcaps.camera.lens import LensEquidistant
from vrcaps.cli import main
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.estimates import aligned, with_depth, with_poses

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from vrcaps.tools.reconstruction.fusion.odometry import OdometrySettings, estimated_poses  # noqa: E402
from vrcaps.tools.reconstruction.fusion.pose_adjustment import (  # noqa: E402
    Deviations,
    PosePair,
    View,
    adjusted_poses,
    pose_pair,
)

SIDE = 200
LENS = LensEquidistant(focal=80.0, cx=99.5, cy=99.5, max_angle=1.2)
DEVIATIONS = Deviations(angle=0.01, distance=0.1)


def _poses(count: int) -> np.ndarray:
    k = np.arange(count)[:, None]
    turns = k * np.array([0.02, -0.05, 0.04])
    return transform_from(rotation_from_vector(turns), 1e-3 * k * np.array([1.0, 0.4, 1.5]))


def _views(poses: np.ndarray, chance: np.random.Generator, count: int = 60) -> list[View]:
    """The same places, seen by all cameras."""
    world = chance.uniform([-0.02, -0.02, 0.02], [0.02, 0.02, 0.06], (count, 3))
    unit = chance.standard_normal((count, 32)).astype(np.float32)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    points = [transform_points(invert(pose), world) for pose in poses]
    return [View(unit, one / np.linalg.norm(one, axis=1, keepdims=True), one) for one in points]


def test_motion_is_found_among_wrong_matches():
    chance = np.random.default_rng(0)
    poses = _poses(4)[[0, 3]]
    one, other = _views(poses, chance)
    wrong = np.arange(24)
    other.points[wrong] = other.points[chance.permutation(wrong)[::-1]]
    other.rays[wrong] = other.points[wrong] / np.linalg.norm(other.points[wrong], axis=1)[:, None]
    pair = pose_pair((0, 1), one, other, tolerance=0.01)
    np.testing.assert_allclose(pair.T_second_first, invert(poses[1]) @ poses[0], atol=1e-6)
    assert set(range(24, 60)) <= {*pair.matches[:, 0].tolist()}
    assert pair.num_inliers < 42
    strangers = _views(poses, chance)[0]
    assert pose_pair((0, 1), one, strangers, tolerance=0.01) is None


def test_motion_needs_enough_matches():
    few = _views(_poses(2), np.random.default_rng(1), count=6)
    assert pose_pair((0, 1), *few, tolerance=0.01) is None


def _pairs(truth: np.ndarray, num_points: int) -> list[PosePair]:
    matches = np.repeat(np.arange(num_points)[:, None], 2, axis=1)
    return [
        PosePair(i, j, invert(truth[j]) @ truth[i], matches)
        for i in range(len(truth))
        for j in range(i + 1, min(i + 3, len(truth)))
    ]


def test_poses_of_exact_matches_are_exact():
    chance, truth = np.random.default_rng(2), _poses(8)
    views, pairs = _views(truth, chance), _pairs(truth, 60)
    rough = truth @ transform_from(
        rotation_from_vector(0.02 * chance.standard_normal((8, 3))),
        1e-3 * chance.standard_normal((8, 3)),
    )
    rough[0] = truth[0]
    found = adjusted_poses(rough, views, pairs, DEVIATIONS)
    np.testing.assert_allclose(found, truth, atol=1e-7)
    np.testing.assert_array_equal(found[0], truth[0])
    np.testing.assert_array_equal(adjusted_poses(rough, views, [], DEVIATIONS), rough)


def test_wrong_matches_hardly_move_poses():
    chance, truth = np.random.default_rng(3), _poses(8)
    views, pairs = _views(truth, chance), _pairs(truth, 60)
    wrong = np.stack([np.arange(60), chance.permutation(60)], axis=1)
    pairs = [*pairs, PosePair(0, 7, np.eye(4), wrong), PosePair(2, 6, np.eye(4), wrong)]
    found = adjusted_poses(truth, views, pairs, DEVIATIONS)
    np.testing.assert_allclose(found, truth, atol=0.1 * DEVIATIONS.angle)
    least_squares = adjusted_poses(truth, views, pairs, Deviations(angle=10.0, distance=10.0))
    assert np.abs(least_squares - truth).max() > 1e-2


def _assert_near(found: np.ndarray, truth: np.ndarray, *, places: float) -> None:
    """Poses from images of 0.7 degrees a pixel, whose features are known to a sixth of one."""
    np.testing.assert_allclose(found[:, :3, :3], truth[:, :3, :3], atol=2e-3)
    np.testing.assert_allclose(found[:, :3, 3], truth[:, :3, 3], atol=places)


def _textured(frames: int) -> FrameSequence:
    return spotted_sequence(LENS, SIDE, frames=frames)


@pytest.mark.slow
def test_run_is_followed_through_a_fisheye_in_meters():
    sequence = _textured(4)
    found = estimated_poses(sequence, OdometrySettings())
    assert found.frames.tolist() == list(range(4))
    truth = sequence.Ts_world_camera
    _assert_near(found.Ts_first_camera, invert(truth[0]) @ truth, places=5e-5)
    larger = with_depth(sequence, lambda index: 1.5 * sequence.image("depth", index))
    scaled = estimated_poses(larger, OdometrySettings()).Ts_first_camera
    np.testing.assert_allclose(scaled[:, :3, 3], 1.5 * found.Ts_first_camera[:, :3, 3], atol=1e-4)


def test_frames_that_show_nothing_are_left_out():
    sequence = _textured(4)
    found = estimated_poses(blanked(sequence, {2}), OdometrySettings(num_features=300))
    assert found.frames.tolist() == [0, 1, 3]
    truth = sequence.Ts_world_camera[found.frames]
    _assert_near(found.Ts_first_camera, invert(truth[0]) @ truth, places=1e-4)


def test_bad_input_is_one_clear_line(tmp_path, capsys):
    sequence = _textured(3)
    with pytest.raises(InputError, match=r"No two of 3 frames of ball/front overlap"):
        estimated_poses(blanked(sequence, {0, 1, 2}), OdometrySettings())
    with pytest.raises(InputError, match="ball/front has no calibrated camera, which odometry"):
        estimated_poses(replace(sequence, camera=None), OdometrySettings())
    with pytest.raises(InputError, match=r"reach is 0\. Allowed: 1 or more"):
        OdometrySettings(reach=0)
    flags = [["--odometry", "--poses", "p.txt"], ["--odometry", "--method", "stitching"]]
    said = ["--poses and --odometry are both given", "--odometry requires --method fusion"]
    for some, words in zip(flags, said, strict=True):
        with pytest.raises(SystemExit, match="2"):
            main(["reconstruct", str(tmp_path), "--out", str(tmp_path / "out"), *some])
        assert words in capsys.readouterr().err


@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_aligned_poses_and_depth_are_the_true_ones(align):
    sequence = _textured(4)
    truth = sequence.Ts_world_camera
    truth = truth @ transform_from(
        np.eye(3), np.array([[0, 0, 0], [1e-3, 0, 0], [0, 2e-3, 0]] * 2)[:4]
    )
    scale = 2.0 if align == "sim3" else 1.0
    elsewhere = transform_from(rotation_from_vector(np.array([0.5, -1.0, 0.3])), np.ones(3))
    moved = elsewhere @ truth
    moved[:, :3, 3] /= scale
    estimate = with_depth(sequence, lambda index: sequence.image("depth", index) / scale)
    found = aligned(with_poses(estimate, moved), truth, align)
    np.testing.assert_allclose(found.Ts_world_camera, truth, atol=1e-9)
    np.testing.assert_allclose(found.image("depth", 1), sequence.image("depth", 1), rtol=1e-6)


def test_turn_about_a_straight_path_is_known_from_what_is_seen():
    sequence = _textured(4)  # its places are on one line
    truth = sequence.Ts_world_camera
    noise = 1e-6 * np.random.default_rng(5).standard_normal((4, 3))
    shaken = truth @ transform_from(np.eye(3), noise)
    found = aligned(with_poses(sequence, shaken), truth, "se3").Ts_world_camera
    np.testing.assert_allclose(found, truth, atol=1e-4)
