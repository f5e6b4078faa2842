"""Errors of an estimated camera motion, next to a static camera and to a constant velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import invert, transform_from
from vrcaps.metrics.trajectory import relative_pose_error

if TYPE_CHECKING:
    from jaxtyping import Float

    Poses = Float[np.ndarray, "n 4 4"]

_MIN_STEP = 5e-5
"""Minimum length of a true step whose direction is compared [m]."""


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
