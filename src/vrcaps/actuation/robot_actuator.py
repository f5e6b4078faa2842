"""Robot arm as a magnet actuator, with the limits of its joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.actuation.arm.arm_with_payload import ArmWithPayload, magnet_pose_at, solve_joint_angles
from vrcaps.actuation.magnet_actuator import ActuatorState
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.core.errors import InputError, require

if TYPE_CHECKING:
    from jaxtyping import Float


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
                f"A state of {len(state.joint_angles)} joints for arm {self.robot.arm.name}. "
                f"Allowed: {count}, as `start` gives it."
            )
        goal = np.asarray(T_world_magnet, float)
        moved = self._core.move_towards(
            state.T_world_magnet, state.velocity, state.joint_angles, goal, dt
        )
        return ActuatorState(*moved)
