"""Arm actuation: joint velocities of a robot that carries an external magnet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.actuation.arm.arm import read_arm
from vrcaps.actuation.arm.arm_with_payload import (
    ArmWithPayload,
    clearances,
    magnet_pose_at,
    transverse_mount,
)
from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.actuation.steering_program import BASE_BELOW, base_beside, workspace_above
from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError, require
from vrcaps.core.units import CM
from vrcaps.env.actuation.actuation import Actuation
from vrcaps.env.actuation.magnet import supporting_pose
from vrcaps.magnet.presets import read_magnet
from vrcaps.world.control import Control

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.simulation import Simulation
    from vrcaps.magnet.sources import Source
    from vrcaps.world.model import State

_LIMITS = np.array(["", "joint", "collision"], object)
"""Limits that may have modified the arm's motion, by the value of `arm/limit`."""


@dataclass(frozen=True)
class ArmActuation(Actuation):
    """A robot arm next to the patient that holds a magnet across its flange.

    An action has a value from −1 to 1 for each joint: its velocity, relative to `fraction` of its
    limit. A joint stops at the end of its range. The arm stops before a self-collision, and before
    its links or its magnet come below `standoff` above the organ's highest point: the plane of the
    patient and the table. `info["arm_limit"]` is then `joint` or `collision`.

    Attributes:
        arm: Name or file of the arm.
        magnet: Name of the magnet, see `vrcaps.magnet.presets.magnet_names`.
        fraction: Maximum velocity of each joint, as a fraction of its limit.
        standoff: Minimum gap between the organ's highest point and the magnet [m].
    """

    arm: str = "panda"
    magnet: str = "cylinder-76.2"
    fraction: Annotated[float, Range(above=0.0, max=1.0)] = 0.1
    standoff: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 4.0 * CM

    kind: ClassVar[str] = "arm"

    def __post_init__(self) -> None:
        check_fields(self)
        home = np.array([self._robot.arm.home])
        gap = float(clearances(self._robot, home).min())
        allowed = "one with which the arm at rest is above the patient and off itself"
        require(gap >= 0.0, "ArmActuation's standoff", f"{self.standoff:g} m", allowed)

    @cached_property
    def _actuator(self) -> RobotActuator:
        """The arm with its magnet above the plane of the patient, in the frame of its base."""
        magnet = read_magnet(self.magnet)
        plane = BASE_BELOW + self.standoff
        mount = transverse_mount(magnet)
        return RobotActuator(
            ArmWithPayload(read_arm(self.arm), magnet, np.eye(4), mount, table_height=plane)
        )

    @property
    def _robot(self) -> ArmWithPayload:
        return self._actuator.robot

    @cached_property
    def _ranges(self) -> tuple[Float[np.ndarray, " j"], ...]:
        """Minimum and maximum angles [rad], and maximum velocities [rad/s]."""
        arm = self._robot.arm
        velocity = np.array([joint.velocity for joint in arm.joints])
        return arm.lower, arm.upper, self.fraction * velocity

    def space(self) -> Any:
        """Action space: a value from −1 to 1 for each joint."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, (self._robot.arm.num_joints,), np.float32)

    def allocate(self, simulation: Simulation) -> None:
        """Allocate joint angles, the base's position, and the magnet's pose."""
        memory = simulation.memory
        memory.allocate("magnet/T", (4, 4))
        memory.allocate("arm/joints", (self._robot.arm.num_joints,))
        memory.allocate("arm/base", (3,))
        memory.allocate("arm/limit", dtype=np.int64)

    def begin(self, simulation: Simulation, index: int, start: State) -> tuple[Source, ...]:
        """Place the magnet above the capsule; the arm is at rest if it cannot reach there.

        Raises:
            InputError: If the capsule contains no magnet.
        """
        model, memory = simulation.patient(index).model, simulation.memory
        magnet, base = self._robot.magnet, base_beside(model)
        # The magnet's edge stays above the plane for any orientation.
        edge = 0.5 * (math.hypot(magnet.diameter, magnet.length) - magnet.diameter)
        workspace = workspace_above(model, magnet, self.standoff + edge)
        T_base_magnet = supporting_pose(model, magnet, workspace, start.T_world_capsule)
        T_base_magnet[:3, 3] -= base
        try:
            angles = self._actuator.start(T_base_magnet).joint_angles
        except InputError:  # out of reach
            angles = np.array(self._robot.arm.home)
        memory["arm/joints"][index] = angles
        memory["arm/base"][index] = base
        memory["arm/limit"][index] = 0
        memory["magnet/T"][index] = magnet_pose_at(self._robot, angles)
        memory["magnet/T"][index, :3, 3] += base
        return (read_magnet(self.magnet, memory["magnet/T"][index].copy()),)

    def controls(
        self, simulation: Simulation, actions: np.ndarray, numbers: np.ndarray
    ) -> Sequence[Control]:
        """Move the arm for a control period, or stop it."""
        memory, (lower, upper, velocity) = simulation.memory, self._ranges
        now = memory["arm/joints"][numbers]
        step = simulation.settings.control_period * velocity
        wanted = now + step * np.asarray(actions, float)[numbers]
        angles = np.clip(wanted, lower, upper)
        collides = clearances(self._robot, angles).min(axis=1) < 0.0
        memory["arm/limit"][numbers] = np.where(collides, 2, (angles != wanted).any(axis=1))
        angles = np.where(collides[:, None], now, angles)
        memory["arm/joints"][numbers] = angles
        poses = magnet_pose_at(self._robot, angles)
        poses[:, :3, 3] += memory["arm/base"][numbers]
        memory["magnet/T"][numbers] = poses
        return [Control(Ts_world_magnet=pose[None]) for pose in poses]

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Return the limit that modified each arm's motion."""
        return {"arm_limit": _LIMITS[simulation.memory["arm/limit"]]}
