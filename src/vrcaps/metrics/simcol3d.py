"""Metrics of the SimCol3D challenge (Rau et al., Medical Image Analysis 96, 2024).

Depth: one factor per trajectory, then mean L1, mean of the images' median relative errors, and mean
RMSE. Pose: one factor per trajectory, chained from the first pose, then medians of the absolute
trajectory error (ATE), of the relative one (RTE) and of its rotation (ROT).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require_one_shape
from vrcaps.core.geometry import invert, transform_from
from vrcaps.core.units import CM
from vrcaps.metrics.trajectory import relative_pose_error

if TYPE_CHECKING:
    from jaxtyping import Float

_FULL_SCALE = 20.0 * CM
"""Maximum depth to which estimates are clipped [m]."""
_OFFSET = 1e-4 * CM
"""Offset of the truth in the relative error [m]."""


@dataclass(frozen=True)
class DepthScore:
    """Depth metrics of one trajectory.

    Attributes:
        scale: Factor applied to the estimates.
        l1: Mean absolute error [m].
        relative: Mean over images of the median relative error.
        rmse: Mean over images of the root mean square error [m].
    """

    scale: float
    l1: float
    relative: float
    rmse: float


@dataclass(frozen=True)
class PoseScore:
    """Pose metrics of one trajectory.

    Attributes:
        scale: Factor applied to the estimated translations.
        ate: Median distance from the true position [m].
        rte: Median error of the translation between frames [m].
        rot: Median error of the rotation between frames [rad].
    """

    scale: float
    ate: float
    rte: float
    rot: float


def score_depth(
    estimates: Float[np.ndarray, "n h w"], truths: Float[np.ndarray, "n h w"]
) -> DepthScore:
    """Depth metrics of a whole trajectory, from depths [m]; every pixel has both.

    Raises:
        InputError: If the shapes differ.
    """
    require_one_shape(estimates, truths)
    d, t = np.clip(estimates, 0.0, _FULL_SCALE), truths
    means, goals = d.mean(axis=(1, 2)), t.mean(axis=(1, 2))
    scale = float(np.sum(means * goals) / np.sum(means**2))
    error = np.abs(scale * d - t)
    return DepthScore(
        scale,
        float(np.mean(error)),
        float(np.mean(np.median(error / (t + _OFFSET), axis=(1, 2)))),
        float(np.mean(np.sqrt(np.mean(error**2, axis=(1, 2))))),
    )


def score_poses(
    relative: Float[np.ndarray, "m 4 4"], truth: Float[np.ndarray, "n 4 4"]
) -> PoseScore:
    """Pose metrics of estimated motions between frames.

    Args:
        relative: Estimated ``T_i_j``, j = i + 1: pose of camera j in camera i; m = n − 1.
        truth: True ``T_world_camera`` of all frames.

    Raises:
        InputError: If the number of motions is not one less than that of frames.
    """
    motions = invert(truth[:-1]) @ truth[1:]
    require_one_shape(relative, motions)
    steps, goals = relative[:, :3, 3], motions[:, :3, 3]
    scale = float(np.sum(steps * goals) / np.sum(steps**2))
    path = _chained(relative)
    estimate = transform_from(path[:, :3, :3], scale * path[:, :3, 3])
    true_path = _chained(motions)
    error = relative_pose_error(estimate, true_path)
    distance = np.linalg.norm(estimate[:, :3, 3] - true_path[:, :3, 3], axis=1)
    medians = (float(np.median(x)) for x in (distance, error.translation, error.rotation))
    return PoseScore(scale, *medians)


def _chained(motions: np.ndarray) -> np.ndarray:
    """Poses in the first camera's frame."""
    poses = [np.eye(4)]
    for motion in motions:
        poses.append(poses[-1] @ motion)
    return np.stack(poses)
