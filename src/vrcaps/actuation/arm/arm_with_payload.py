"""Robot arm with a magnet as payload at its flange."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.actuation.arm.arm import forward, nearest
from vrcaps.actuation.arm.chain import Arm, Link
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert
from vrcaps.core.rng import stream
from vrcaps.magnet.sources import Magnet, check_pose

if TYPE_CHECKING:
    from jaxtyping import Float

MOUNT_GAP = 0.03
"""Default gap between flange and magnet [m]."""


@dataclass(frozen=True)
class ArmWithPayload:
    """Robot arm that carries a magnet.

    Attributes:
        arm: The arm.
        magnet: The magnet; its pose is set by the arm.
        T_world_base: Pose of the arm's base.
        T_flange_magnet: Pose of the magnet's center in the flange; by default along the flange's z,
            beyond a mount of 30 mm.
        table_height: Height in the world [m] below which neither the magnet nor the arm's links
            from the second joint on may be; None for no table.
    """

    arm: Arm
    magnet: Magnet
    T_world_base: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    T_flange_magnet: Float[np.ndarray, "4 4"] | None = None
    table_height: float | None = None

    def __post_init__(self) -> None:
        check_pose("T_world_base", self.T_world_base)
        if self.T_flange_magnet is not None:
            check_pose("T_flange_magnet", self.T_flange_magnet)

    @cached_property
    def mount(self) -> Float[np.ndarray, "4 4"]:
        """``T_flange_magnet`` with the default filled in."""
        if self.T_flange_magnet is not None:
            return np.asarray(self.T_flange_magnet, float)
        mount = np.eye(4)
        mount[2, 3] = MOUNT_GAP + 0.5 * self.magnet.bounds[1]
        return mount

    @cached_property
    def T_base_world(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the world in the arm's base frame."""
        return invert(self.T_world_base)

    @cached_property
    def T_magnet_flange(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the flange in the magnet frame."""
        return invert(self.mount)

    @property
    def payload_ratio(self) -> float:
        """Mass of the magnet, without the mount, as a fraction of the arm's payload."""
        return self.magnet.mass / self.arm.payload

    @property
    def overload_note(self) -> str:
        """Note on a magnet heavier than the arm's payload, else empty."""
        if self.payload_ratio <= 1.0:
            return ""
        return (
            f"The magnet weighs {self.magnet.mass:.1f} kg, but arm {self.arm.name} may carry "
            f"{self.arm.payload:g} kg: it moves as if it could. To build this, take a lighter "
            "magnet or a stronger arm."
        )

    @cached_property
    def loaded_arm(self) -> Arm:
        """Arm with a collision capsule around the magnet at its flange."""
        diameter, length = self.magnet.bounds
        half = 0.5 * length * self.mount[:3, 2]
        start, end = (tuple((self.mount[:3, 3] + offset).tolist()) for offset in (-half, half))
        link = Link(self.arm.num_joints + 1, start, end, 0.5 * diameter)
        return replace(self.arm, links=(*self.arm.links, link))

    @cached_property
    def core(self) -> _core.ArmWithPayload:
        """Arm with payload in the form of the compiled core."""
        return _core.ArmWithPayload(
            self.arm.core,
            self.loaded_arm.core,
            np.asarray(self.T_world_base, float),
            self.mount,
            self.magnet.bounds,
            self.table_height,
        )


def transverse_mount(magnet: Magnet) -> Float[np.ndarray, "4 4"]:
    """``T_flange_magnet`` of a magnet with its moment along the flange's x, across its axis.

    With the flange pointing down, the moment is horizontal, as needed above a lying capsule.
    """
    mount = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]], float)
    mount[2, 3] = MOUNT_GAP + 0.5 * magnet.bounds[0]
    return mount


def magnet_pose_at(
    robot: ArmWithPayload, angles: Float[np.ndarray, "*n j"]
) -> Float[np.ndarray, "*n 4 4"]:
    """Pose ``T_world_magnet`` for joint angles [rad].

    Raises:
        InputError: If there is not one finite angle per joint.
    """
    return robot.T_world_base @ forward(robot.arm, angles) @ robot.mount


def flange_pose_at(
    robot: ArmWithPayload, Ts_world_magnet: Float[np.ndarray, "*n 4 4"]
) -> Float[np.ndarray, "*n 4 4"]:
    """Pose ``T_base_flange`` that gives a pose of the magnet."""
    return robot.T_base_world @ Ts_world_magnet @ robot.T_magnet_flange


def clearances(robot: ArmWithPayload, angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n 2"]:
    """Minimum distances [m] between the arm's links and its magnet, and from them to the table.

    Negative values are penetration depths. Links are capsules, and so is the magnet relative to
    links; relative to the table it is its bounding cylinder. Without a table the second is
    infinite.
    """
    return robot.core.clearance(angles)


def solve_joint_angles(
    robot: ArmWithPayload,
    T_world_magnet: Float[np.ndarray, "4 4"],
    near: Float[np.ndarray, " j"] | None = None,
) -> Float[np.ndarray, " j"]:
    """Joint angles [rad] that hold the magnet at a pose, nearest to `near` (default: home).

    An arm without a closed form starts from `near`, then from home, then from 30 random angles,
    which are the same in every call.

    Raises:
        InputError: If the pose is not rigid, the magnet would be in the table, the arm cannot
            reach the pose within its limits, or it would collide with itself or the table.
    """
    check_pose("T_world_magnet", T_world_magnet)
    table = robot.table_height
    height = robot.core.lowest(np.asarray(T_world_magnet, float))
    if table is not None and height < table:
        raise InputError(
            f"The magnet would penetrate the table by {(table - height) * 1e3:.1f} mm. "
            f"Allowed: its lowest point at a height of {table:g} m or more."
        )
    home = np.array(robot.arm.home if near is None else near)
    flange = flange_pose_at(robot, T_world_magnet)
    angles = nearest(robot.arm, flange, home, rng=stream(0, "arm/joint-angles"))
    if np.isnan(angles).any():
        raise InputError(
            f"Arm {robot.arm.name} does not reach a magnet at {T_world_magnet[:3, 3]} m with its "
            f"moment along {T_world_magnet[:3, 2]}. Bring it nearer to the base (arm_base) or turn "
            "it."
        )
    _check_clear(robot, angles[None])
    return angles


def _check_clear(robot: ArmWithPayload, angles: np.ndarray) -> None:
    clear = clearances(robot, angles)
    if clear.min() < 0.0:
        row, kind = np.unravel_index(np.argmin(clear), clear.shape)
        what = ("itself", "the table")[int(kind)]
        raise InputError(
            f"Pose {row}: arm {robot.arm.name} penetrates {what} by {-1e3 * clear.min():.1f} mm. "
            "Choose another pose, or start from other angles."
        )


def follow(
    robot: ArmWithPayload,
    Ts_world_magnet: Float[np.ndarray, "n 4 4"],
    start: Float[np.ndarray, " j"],
    dt: float,
) -> Float[np.ndarray, "n j"]:
    """Joint angles [n j] that move the magnet along a path, each nearest to the previous ones.

    Args:
        robot: The arm and its magnet.
        Ts_world_magnet: Poses of the magnet, `dt` apart; the arm reaches the first after `dt`.
        start: Angles before the first pose [rad].
        dt: Time between poses [s].

    Raises:
        InputError: If a pose is out of reach, the arm would collide with itself or the table, or a
            joint would exceed its speed limit.
    """
    targets = flange_pose_at(robot, np.asarray(Ts_world_magnet, float))
    home = np.array([robot.arm.home])
    angles = robot.arm.core.follow(targets, np.asarray(start, float), home)
    lost = np.isnan(angles).any(axis=1)
    if lost.any():
        raise InputError(
            f"Pose {int(np.argmax(lost))} of {len(targets)} is out of reach of arm "
            f"{robot.arm.name}. Bring the path nearer to the base or turn the magnet."
        )
    check_speed(robot.arm, np.vstack([np.asarray(start, float)[None], angles]), dt)
    _check_clear(robot, angles)
    return angles


def check_speed(arm: Arm, angles: Float[np.ndarray, "n j"], dt: float) -> None:
    """Check that the joint speeds between angles `dt` apart are within limits.

    Raises:
        InputError: If not; states the joint, its speed and a remedy.
    """
    limit = np.array([joint.velocity for joint in arm.joints])
    _require_time(dt)
    ratio = np.abs(np.diff(angles, axis=0)) / dt / limit
    if ratio.size and ratio.max() > 1.0:
        step, joint = np.unravel_index(np.argmax(ratio), ratio.shape)
        raise InputError(
            f"Step {step}: joint {joint + 1} of arm {arm.name} would turn at "
            f"{ratio.max() * limit[joint]:.3g} rad/s. Allowed: {limit[joint]:g}; "
            f"take {ratio.max():.2f} times as long."
        )


def limit_utilization(
    arm: Arm, angles: Float[np.ndarray, "n j"], dt: float
) -> Float[np.ndarray, "3 j"]:
    """Maximum speed, acceleration and jerk of each joint as fractions of its limits.

    Computed from finite differences of angles at intervals of `dt`; values
    above 1 exceed the limits. Needs four or more angles. The start of a motion is included only if
    the angles include rest before it.

    Raises:
        InputError: If `dt` is not above 0, or there are fewer than four angles.
    """
    _require_time(dt)
    if len(angles) < 4:
        raise InputError(f"Jerk is not defined for {len(angles)} angles. Allowed: 4 or more.")
    limits = np.array([[j.velocity, j.acceleration, j.jerk] for j in arm.joints]).T
    peaks = [np.abs(np.diff(angles, n=n, axis=0)).max(axis=0) / dt**n for n in (1, 2, 3)]
    return np.array(peaks) / limits


def _require_time(dt: float) -> None:
    if not (np.isfinite(dt) and dt > 0.0):
        raise InputError(f"dt is {dt}. Allowed: above 0 s.")


def reachability(
    robot: ArmWithPayload, Ts_world_magnet: Float[np.ndarray, "*n 4 4"]
) -> Float[np.ndarray, "*n"]:
    """Check whether the arm can hold its magnet at each pose without collision: 1 or 0.

    The mean over orientations at a grid of positions is a reachability map. Only the solutions
    nearest to the arm's home are considered; a pose for which only another solution is free of
    collisions counts as 0.
    """
    poses = np.asarray(Ts_world_magnet, float)
    flat = flange_pose_at(robot, poses).reshape(-1, 4, 4)
    angles = nearest(robot.arm, flat, np.array(robot.arm.home))
    is_solved = ~np.isnan(angles).any(axis=1)
    clear = np.zeros(len(flat))
    if is_solved.any():
        clear[is_solved] = clearances(robot, angles[is_solved]).min(axis=1) >= 0.0
    return clear.reshape(poses.shape[:-2])
