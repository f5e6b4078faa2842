"""Pose of a magnet from its position and direction, and the check of poses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

_ORTHONORMAL = 1e-6


def magnet_pose(
    position: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "4 4"]:
    """``T_world_magnet`` of a source at `position` [m] whose moment is along `direction`.

    The rotation about that axis, which does not affect axial fields, is the shortest from world z.

    Raises:
        InputError: If the direction is zero or a number is not finite.
    """
    position, z = np.asarray(position, float), np.asarray(direction, float)
    length = np.linalg.norm(z)
    if not (np.isfinite(length) and length > 0.0 and np.isfinite(position).all()):
        raise InputError(
            f"A magnet at {position} along {z} has no pose. Give finite numbers, no zero direction."
        )
    z = z / length
    pose = np.eye(4)
    pose[:3, 3] = position
    if z[2] < 0.0:  # half a turn about x first, to avoid a division by zero
        flip = np.diag([1.0, -1.0, -1.0])
        pose[:3, :3] = _shortest(flip @ z)
        pose[:3, :3] = flip @ pose[:3, :3]
    else:
        pose[:3, :3] = _shortest(z)
    return pose


def _shortest(z: np.ndarray) -> np.ndarray:
    """Shortest rotation that takes the z axis to `z`, z·e_z ≥ 0."""
    x, y, c = z
    k = 1.0 / (1.0 + c)
    return np.array(
        [[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, c]]
    )


def check_pose(name: str, pose: np.ndarray) -> None:
    """Check that a pose is rigid.

    Raises:
        InputError: If it is not a finite 4×4 matrix of a rotation and a position.
    """
    if not _is_rigid(np.asarray(pose)):
        raise InputError(f"{name} is not a rigid pose. Allowed: 4 x 4, rotation and position [m].")


def _is_rigid(pose: np.ndarray) -> bool:
    """Scalar implementation, as it is called at every step of a control loop."""
    if pose.shape != (4, 4):
        return False
    (a, b, c, x), (d, e, f, y), (g, h, i, z), last = pose.tolist()
    products = (
        *(a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0),
        *(a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i),
    )
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return (
        all(abs(product) < _ORTHONORMAL for product in products)
        and all(map(math.isfinite, (x, y, z)))
        and determinant > 0.0
        and last == [0.0, 0.0, 0.0, 1.0]
    )
