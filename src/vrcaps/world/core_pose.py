"""Conversion of poses to and from the compiled core, one function per direction.

The core works in the patient frame, relative to the center of the wall. There, a moving body is
(position, wxyz, velocity, angular velocity); sources are rows of position, wxyz and strength in the
world.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.transforms import (
    invert,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotate_vectors,
    transform_from,
)

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps import _core
    from vrcaps.world.model import State


def core_pose(
    state: State, T_world_patient: Float[np.ndarray, "4 4"], center: Float[np.ndarray, " 3"]
) -> _core.Pose:
    """Convert the capsule of a state to the core's pose.

    Args:
        state: State in the world frame.
        T_world_patient: Pose of the patient.
        center: Center of the wall in the patient frame [m].

    Raises:
        InputError: If the state is not finite.
    """
    for name in ("T_world_capsule", "linear_velocity_world", "angular_velocity_world"):
        if not np.isfinite(getattr(state, name)).all():
            raise InputError(f"The start's {name} is not finite. Allowed: finite numbers.")
    to_patient = invert(T_world_patient)
    pose = to_patient @ state.T_world_capsule
    velocity = np.array([state.linear_velocity_world, state.angular_velocity_world])
    linear, angular = rotate_vectors(to_patient, velocity)
    wxyz = quaternion_from_matrix(pose[:3, :3])
    return tuple(pose[:3, 3] - center), tuple(wxyz), tuple(linear), tuple(angular)


def center_of_mass_and_rotation(
    pose: _core.Pose,
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Position relative to the wall's center [m], and rotation from the body frame."""
    return np.array(pose[0]), matrix_from_quaternion(np.array(pose[1]))


def rows_from_poses(Ts_world_source: Float[np.ndarray, "k 4 4"]) -> Float[np.ndarray, "k 8"]:
    """Position [m], wxyz and a strength of 1 for each source."""
    wxyz = quaternion_from_matrix(Ts_world_source[:, :3, :3])
    ones = np.ones((len(Ts_world_source), 1))
    return np.concatenate([Ts_world_source[:, :3, 3], wxyz, ones], axis=1)


def poses_from_rows(rows: Float[np.ndarray, "k 8"]) -> Float[np.ndarray, "k 4 4"]:
    """Convert rows of `rows_from_poses` to poses."""
    return transform_from(matrix_from_quaternion(rows[:, 3:7]), rows[:, :3])
