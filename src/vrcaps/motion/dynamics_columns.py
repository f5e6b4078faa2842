"""Columns of `frames.parquet` for dynamics: contact, commands and magnetic coupling."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.transforms import quaternion_from_matrix

if TYPE_CHECKING:
    from vrcaps.actuation.magnet_controller import ControllerStatus
    from vrcaps.motion.motion import Command
    from vrcaps.sensors.pose_filter import PoseBelief
    from vrcaps.world.model import Contact, Coupling

_POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

SPEED_ALONG_GUT = "capsule_along_gut_m_per_s"
"""Column of every commanded frame."""

DYNAMICS_COLUMNS = (
    *(f"contact_force_{axis}_n" for axis in "xyz"),
    *(f"contact_torque_{axis}_nm" for axis in "xyz"),
    "normal_force_total_n",
    "friction_work_j",
    "contact_area_m2",
    "contact_depth_m",
    *(f"commanded_force_{axis}_n" for axis in "xyz"),
    *(f"commanded_torque_{axis}_nm" for axis in "xyz"),
    "insufflation",
    *(f"patient_{name}" for name in _POSE),
    "mmc_phase",
)
"""Columns of every dynamic motion."""

MAGNET_COLUMNS = (
    *(f"magnet_{name}" for name in _POSE),
    *(f"flux_density_{axis}_t" for axis in "xyz"),
    *(f"magnetic_force_{axis}_n" for axis in "xyz"),
    *(f"magnetic_torque_{axis}_nm" for axis in "xyz"),
    *(f"required_force_{axis}_n" for axis in "xyz"),
    "coupling_angle_rad",
    "coupling_distance_m",
    "position_error_m",
    "heading_error_rad",
    "magnet_limit",
    "coupling_lost",
)
"""Further columns with a steering magnet; those of an arm's joints follow."""

ESTIMATE_COLUMNS = (
    *(f"estimated_{name}" for name in _POSE),
    *(f"estimated_velocity_{axis}_m_per_s" for axis in "xyz"),
    "estimated_position_sigma_m",
    "estimated_roll_sigma_rad",
)
"""Further columns if the controller uses an estimated pose."""


def dynamics_row(contact: Contact, command: Command) -> dict[str, float]:
    """Row of `DYNAMICS_COLUMNS`."""
    pose = command.T_world_patient
    values = (
        *contact.force_world,
        *contact.torque_world,
        contact.normal_force_total,
        contact.friction_work,
        contact.area,
        contact.depth,
        *command.force_world,
        *command.torque_world,
        command.insufflation,
        *pose[:3, 3],
        *quaternion_from_matrix(pose[:3, :3]),
        command.phase,
    )
    return dict(zip(DYNAMICS_COLUMNS, values, strict=True))


def magnet_row(coupling: Coupling, status: ControllerStatus) -> dict[str, float | str]:
    """Row of `MAGNET_COLUMNS`, and the joint angles of an arm."""
    actuator = status.actuator
    values = (
        *actuator.T_world_magnet[:3, 3],
        *quaternion_from_matrix(actuator.T_world_magnet[:3, :3]),
        *coupling.flux_density_world,
        *coupling.force_world,
        *coupling.torque_world,
        *status.required_force,
        coupling.angle,
        coupling.distance,
        float(np.linalg.norm(status.position_error)),
        status.heading_error,
        actuator.limit,
        status.lost,
    )
    row = dict(zip(MAGNET_COLUMNS, values, strict=True))
    return row | {f"joint_{k}_rad": angle for k, angle in enumerate(actuator.joint_angles, start=1)}


def estimate_row(belief: PoseBelief) -> dict[str, float]:
    """Row of `ESTIMATE_COLUMNS`."""
    pose = belief.T_world_capsule
    values = (
        *pose[:3, 3],
        *quaternion_from_matrix(pose[:3, :3]),
        *belief.velocity_world,
        belief.position_sigma,
        belief.roll_sigma,
    )
    return dict(zip(ESTIMATE_COLUMNS, values, strict=True))
