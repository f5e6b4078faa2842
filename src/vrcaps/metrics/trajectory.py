"""Error metrics of an estimated camera trajectory.

Definitions after Sturm et al., IROS 2012: the absolute trajectory error (ATE) compares positions
after one alignment of the whole; the relative pose error (RPE) compares motions between frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, require, require_one_shape
from vrcaps.core.geometry import invert, transform_from

if TYPE_CHECKING:
    from jaxtyping import Float

    Poses = Float[np.ndarray, "n 4 4"]

TrajectoryAlignment = Literal["none", "se3", "sim3"]
"""Alignment of an estimate: none, a rigid motion, or a rigid motion and a scale."""

_MIN_STEP = 5e-5
"""Minimum length of a true step whose direction is compared [m]."""
_MIN_POSES = 3
"""Minimum number of positions that determine a rotation."""


@dataclass(frozen=True)
class Similarity:
    """Rotation, translation and scale that map points: ``s R p + t``.

    Attributes:
        rotation: Proper rotation [3 3].
        translation: Translation [m].
        scale: Scale, above 0.
    """

    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, " 3"]
    scale: float

    def poses(self, Ts: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """Apply the similarity to poses; their rotations stay rotations."""
        positions = self.scale * Ts[:, :3, 3] @ self.rotation.T + self.translation
        return transform_from(self.rotation @ Ts[:, :3, :3], positions)


@dataclass(frozen=True)
class RelativePoseError:
    """Error of the motion over a number of frames.

    Attributes:
        translation: Magnitude of the translation error of each pair [m].
        rotation: Angle of the rotation error of each pair [rad].
    """

    translation: Float[np.ndarray, " n"]
    rotation: Float[np.ndarray, " n"]


def fit_similarity(
    source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"], *, scale: bool
) -> Similarity:
    """Least-squares similarity from points to points (Umeyama, TPAMI 13(4), 1991).

    Args:
        source: Points to map [m].
        target: Corresponding target points [m].
        scale: Whether to fit a scale; 1 otherwise.

    Raises:
        InputError: If the shapes differ, or the points do not determine a rotation.
    """
    require_one_shape(source, target)
    count = len(source)
    require(count >= _MIN_POSES, "number of positions", count, f"{_MIN_POSES} or more")
    center, goal = source.mean(axis=0), target.mean(axis=0)
    covariance = (target - goal).T @ (source - center) / len(source)
    u, d, vt = np.linalg.svd(covariance)
    if d[1] <= 1e-12 * d[0]:  # eq. 43 needs a rank of at least 2
        raise InputError("The positions are collinear, so they do not determine a rotation.")
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u * sign @ vt
    variance = np.mean(np.sum((source - center) ** 2, axis=1))
    factor = float(np.dot(d, sign) / variance) if scale else 1.0
    return Similarity(rotation, goal - factor * rotation @ center, factor)


def aligned_poses(
    estimate: Float[np.ndarray, "n 4 4"],
    truth: Float[np.ndarray, "n 4 4"],
    align: TrajectoryAlignment,
) -> Float[np.ndarray, "n 4 4"]:
    """Estimated poses after alignment of their positions to the true ones.

    Raises:
        InputError: If the numbers of poses differ, or the positions do not determine a rotation.
        UnknownNameError: If the alignment does not exist.
    """
    if align not in get_args(TrajectoryAlignment):
        raise UnknownNameError("alignment of a trajectory", align, get_args(TrajectoryAlignment))
    require_one_shape(estimate, truth)
    if align == "none":
        return estimate
    source, target = estimate[:, :3, 3], truth[:, :3, 3]
    return fit_similarity(source, target, scale=align == "sim3").poses(estimate)


def absolute_trajectory_error(
    estimate: Float[np.ndarray, "n 4 4"],
    truth: Float[np.ndarray, "n 4 4"],
    *,
    align: TrajectoryAlignment = "sim3",
) -> Float[np.ndarray, " n"]:
    """Distance of each aligned position from the true one [m]; papers report its RMSE.

    Args:
        estimate: Estimated ``T_world_camera``.
        truth: True ``T_world_camera`` of the same frames.
        align: Alignment of the estimate.

    Raises:
        InputError: If the numbers of poses differ, or the positions do not determine a rotation.
        UnknownNameError: If the alignment does not exist.
    """
    moved = aligned_poses(estimate, truth, align)
    return np.linalg.norm(moved[:, :3, 3] - truth[:, :3, 3], axis=1)


def relative_pose_error(
    estimate: Float[np.ndarray, "n 4 4"], truth: Float[np.ndarray, "n 4 4"], *, delta: int = 1
) -> RelativePoseError:
    """Error of the motion between frames i and i + delta, for all i.

    Args:
        estimate: Estimated ``T_world_camera``.
        truth: True ``T_world_camera`` of the same frames.
        delta: Number of frames in between.

    Raises:
        InputError: If the numbers of poses differ, or no pair is that far apart.
    """
    require_one_shape(estimate, truth)
    require(1 <= delta < len(truth), "delta of relative poses", delta, f"1 to {len(truth) - 1}")
    moved = invert(estimate[:-delta]) @ estimate[delta:]
    error = invert(invert(truth[:-delta]) @ truth[delta:]) @ moved
    return RelativePoseError(
        np.linalg.norm(error[:, :3, 3], axis=1), rotation_angle(error[:, :3, :3])
    )


def rotation_angle(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle of a rotation [rad], also exact for small angles.

    ‖R − 1‖ = 2√2 sin(θ/2) in the Frobenius norm.
    """
    chord = np.linalg.norm(rotation - np.eye(3), axis=(-2, -1))
    return 2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0))


def motion_errors(estimate: Poses, truth: Poses) -> dict[str, float]:
    """Errors of an estimated trajectory.

    Args:
        estimate: Estimated ``T_world_camera``.
        truth: True ``T_world_camera`` of the same frames [m].

    Returns:
        `ate`, root mean square position error [m] after the best similarity; `rpe_translation` [m]
            and `rpe_rotation` [rad], mean errors of steps between frames without alignment; and
            `direction`, the mean cosine between estimated and true steps in the camera's frame,
            0 for no step.
    """
    error = relative_pose_error(estimate, truth)
    own, true = _steps(estimate), _steps(truth)
    lengths = [np.linalg.norm(one[:, :3, 3], axis=1) for one in (own, true)]
    dot = (own[:, :3, 3] * true[:, :3, 3]).sum(axis=1)
    cosine = dot / np.maximum(lengths[0] * lengths[1], 1e-12)
    is_moving = lengths[1] > _MIN_STEP
    return {
        "ate": aligned_rmse(estimate[:, :3, 3], truth[:, :3, 3]),
        "rpe_translation": float(error.translation.mean()),
        "rpe_rotation": float(error.rotation.mean()),
        "direction": float(cosine[is_moving].mean()) if is_moving.any() else float("nan"),
    }


def aligned_rmse(estimate: Float[np.ndarray, "n 3"], truth: Float[np.ndarray, "n 3"]) -> float:
    """Root mean square distance of positions after the best similarity; also for a point or line.

    It is the minimum of Umeyama (TPAMI 13(4), 1991, eq. 33), which needs no alignment itself.
    """
    own, true = estimate - estimate.mean(axis=0), truth - truth.mean(axis=0)
    u, d, vt = np.linalg.svd(true.T @ own / len(own))
    d[2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    own_variance, variance = ((one**2).sum(axis=1).mean() for one in (own, true))
    gain = d.sum() ** 2 / own_variance if own_variance > 1e-20 else 0.0
    return float(np.sqrt(max(variance - gain, 0.0)))


def motion_baselines(truth: Poses) -> Mapping[str, Poses]:
    """Trajectories of a static camera and of the mean true motion, repeated at every step.

    The constant velocity is fitted to the true trajectory itself, which favors it.
    """
    from scipy.spatial.transform import Rotation

    steps = _steps(truth)
    rotation = Rotation.from_matrix(steps[:, :3, :3]).mean().as_matrix()
    step = transform_from(rotation, steps[:, :3, 3].mean(axis=0))
    poses = [np.eye(4)]
    for _ in steps:
        poses.append(poses[-1] @ step)
    return {"static": np.tile(np.eye(4), (len(truth), 1, 1)), "constant velocity": np.stack(poses)}


def _steps(Ts: Poses) -> Poses:
    """Motion from each frame to the next, in the frame of its camera."""
    return invert(Ts[:-1]) @ Ts[1:]
