"""Magnet actuators, free or on a robot arm: from a requested magnet pose to the one reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vrcaps import _core
from vrcaps.actuation.arm.arm_with_payload import ArmWithPayload, magnet_pose_at, solve_joint_angles
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import check_fields
from vrcaps.core.geometry import clamp_norm, length, rotate_by_vector, vector_from_rotation
from vrcaps.magnet.sources import check_pose

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class ActuatorState:
    """Pose and velocity of an actuated magnet at one instant.

    Attributes:
        T_world_magnet: Pose of the magnet.
        velocity: Velocity of the magnet [m/s, rad/s] in the world, or of the robot's joints
            [rad/s].
        joint_angles: Joint angles of the robot [rad]; empty without a robot.
        limit: Reason why the magnet has not reached the requested pose: empty, `speed` (or
            acceleration), `workspace`, `unreachable`, `collision` (of the robot with itself or the
            table).
    """

    T_world_magnet: Float[np.ndarray, "4 4"]
    velocity: Float[np.ndarray, " n"]
    joint_angles: Float[np.ndarray, " j"] = field(default_factory=lambda: np.zeros(0))
    limit: str = ""


class MagnetActuator(Protocol):
    """Actuator of a magnet: a robot arm, or an ideal actuator without kinematics."""

    @property
    def workspace(self) -> Workspace:
        """Allowed positions of the magnet."""
        ...

    def start(self, T_world_magnet: Float[np.ndarray, "4 4"]) -> ActuatorState:
        """State at rest at a magnet pose; raises an error if the actuator cannot hold it there."""
        ...

    def move(
        self, state: ActuatorState, T_world_magnet: Float[np.ndarray, "4 4"], dt: float
    ) -> ActuatorState:
        """State after moving towards a pose for `dt` [s]; never raises errors or jumps."""
        ...


@dataclass(frozen=True)
class FreeActuator:
    """Ideal actuator: a magnet without a robot, with limits of speed and acceleration only.

    Attributes:
        workspace: Allowed positions of the magnet.
        max_speed: Maximum speed [m/s].
        max_acceleration: Maximum acceleration [m/s²].
        max_angular_speed: Maximum angular speed [rad/s].
        max_angular_acceleration: Maximum angular acceleration [rad/s²].
    """

    workspace: Workspace = field(default_factory=Workspace)
    max_speed: float = 0.2
    max_acceleration: float = 2.0
    max_angular_speed: float = 2.0
    max_angular_acceleration: float = 20.0

    def __post_init__(self) -> None:
        check_fields(self, of="FreeActuator")
        for name, value in vars(self).items():
            if name.startswith("max_"):
                require(0.0 < value < math.inf, f"FreeActuator's {name}", value, "above 0")

    def start(self, T_world_magnet: Float[np.ndarray, "4 4"]) -> ActuatorState:
        """State at rest at a magnet pose.

        Raises:
            InputError: If the pose is not rigid or outside the workspace.
        """
        check_pose("T_world_magnet", T_world_magnet)
        position = np.asarray(T_world_magnet)[:3, 3]
        low, high = self.workspace.low, self.workspace.high
        is_inside = bool(np.all(position >= low) and np.all(position <= high))
        require(is_inside, "The magnet's position", position, f"{low} to {high} m")
        return ActuatorState(np.array(T_world_magnet, float), np.zeros(6))

    def move(
        self, state: ActuatorState, T_world_magnet: Float[np.ndarray, "4 4"], dt: float
    ) -> ActuatorState:
        """State after moving towards a pose for `dt` [s]."""
        now = state.T_world_magnet
        goal = self.workspace.clamp_pose(T_world_magnet)
        limit = "" if (goal[:3, 3] == T_world_magnet[:3, 3]).all() else "workspace"
        offset = goal[:3, 3] - now[:3, 3]
        rotation = vector_from_rotation(goal[:3, :3] @ now[:3, :3].T)
        linear = _next_velocity(
            offset, state.velocity[:3], self.max_speed, self.max_acceleration, dt
        )
        angular = _next_velocity(
            rotation, state.velocity[3:], self.max_angular_speed, self.max_angular_acceleration, dt
        )
        pose = np.eye(4)
        pose[:3, 3] = self.workspace.clamp(now[:3, 3] + dt * linear)
        pose[:3, :3] = rotate_by_vector(dt * angular, now[:3, :3])
        left = math.dist(pose[:3, 3], goal[:3, 3]) + length(rotation - dt * angular)
        if not limit and left > 1e-3:
            limit = "speed"
        return ActuatorState(pose, np.concatenate([linear, angular]), limit=limit)


def stopping_speed(distance: float, acceleration: float, dt: float) -> float:
    """Maximum speed [m/s] of the next step from which it can still stop within a distance [m].

    For steps of `dt`: v dt + v²/2a = distance.
    """
    a = acceleration * dt
    return math.sqrt(a * a + 2.0 * acceleration * distance) - a


def _next_velocity(
    offset: Float[np.ndarray, " 3"],
    velocity: Float[np.ndarray, " 3"],
    max_speed: float,
    max_acceleration: float,
    dt: float,
) -> Float[np.ndarray, " 3"]:
    """Velocity of the next step towards the end of an offset, within the limits."""
    distance = length(offset)
    wanted = np.zeros(3)
    if distance > 0.0:
        stopping = stopping_speed(distance, max_acceleration, dt)
        wanted = offset * (min(max_speed, distance / dt, stopping) / distance)
    return velocity + clamp_norm(wanted - velocity, max_acceleration * dt)


@dataclass(frozen=True)
class RobotActuator:
    """Robot arm with a magnet at its flange.

    Joints respect their limits of angle, speed, acceleration and jerk. If a pose is unreachable or
    in collision with the arm itself or the table, the arm brakes and reports the reason.

    Attributes:
        robot: The arm and its magnet.
        workspace: Allowed positions of the magnet.
        flange_direction: Target unit direction of the flange in the world, as far as the magnet's
            own axis permits: a rotation about that axis does not change the field.
        max_speed: Maximum speed of the magnet [m/s], at which the arm can immediately stop and
            reverse.
        max_angular_speed: Maximum angular speed of the magnet [rad/s].
    """

    robot: ArmWithPayload
    workspace: Workspace = field(default_factory=Workspace)
    flange_direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    max_speed: float = 0.15
    max_angular_speed: float = 1.0

    def __post_init__(self) -> None:
        for name in ("max_speed", "max_angular_speed"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, f"RobotActuator's {name}", value, "above 0")
        is_unit = abs(math.hypot(*self.flange_direction) - 1.0) < 1e-6
        name = "RobotActuator's flange_direction"
        require(is_unit, name, self.flange_direction, "a unit vector")

    @cached_property
    def _core(self) -> _core.RobotActuator:
        arm = self.robot.arm
        joints = [
            (home, joint.velocity, joint.acceleration, joint.jerk)
            for home, joint in zip(arm.home, arm.joints, strict=True)
        ]
        return _core.RobotActuator(
            self.robot.core,
            np.array(joints, float),
            (self.workspace.low, self.workspace.high),
            self.flange_direction,
            (self.max_speed, self.max_angular_speed),
        )

    def start(
        self, T_world_magnet: Float[np.ndarray, "4 4"], near: Float[np.ndarray, " j"] | None = None
    ) -> ActuatorState:
        """State at rest with the magnet at a pose; joint angles nearest to `near` or home.

        Raises:
            InputError: If the arm cannot hold the magnet there, see `solve_joint_angles`.
        """
        aligned = self._core.align_flange(np.asarray(T_world_magnet, float))
        angles = solve_joint_angles(self.robot, aligned, near)
        return ActuatorState(magnet_pose_at(self.robot, angles), np.zeros_like(angles), angles)

    def move(
        self, state: ActuatorState, T_world_magnet: Float[np.ndarray, "4 4"], dt: float
    ) -> ActuatorState:
        """State after moving towards a pose for `dt` [s], in small steps where needed.

        Raises:
            InputError: If the state is of an arm with another number of joints.
        """
        count = self.robot.arm.num_joints
        if not len(state.joint_angles) == len(state.velocity) == count:
            raise InputError(
                f"The state has {len(state.joint_angles)} joints, for arm {self.robot.arm.name}. "
                f"Allowed: {count}, as `start` gives it."
            )
        goal = np.asarray(T_world_magnet, float)
        moved = self._core.move_towards(
            state.T_world_magnet, state.velocity, state.joint_angles, goal, dt
        )
        return ActuatorState(*moved)
