"""An arm that holds a magnet, with the limits of its joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.actuation.arm.arm_with_payload import Carrier, magnet_at, reach
from vrcaps.actuation.magnet_actuator import Held
from vrcaps.actuation.magnet_pose_solver import Room
from vrcaps.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class ArmHolder:
    """A magnet at an arm's flange.

    Joints keep their limits of angle, speed, acceleration and jerk. A pose out of reach, or at
    which the arm would touch itself or the table, is not gone to: the arm brakes and says why.

    Attributes:
        carrier: The arm and its magnet.
        room: Where the magnet may be.
        reach_along: Direction in the world along which the flange is to point, as nearly as the
            magnet's own axis lets it: a turn about that axis changes no field.
        speed: Largest speed of the magnet [m/s], so that the arm can stop and turn back at once.
        turn_speed: Largest angular speed of the magnet [rad/s].
    """

    carrier: Carrier
    room: Room = field(default_factory=Room)
    reach_along: tuple[float, float, float] = (0.0, 0.0, -1.0)
    speed: float = 0.15
    turn_speed: float = 1.0

    @cached_property
    def _core(self) -> _core.ArmHolder:
        arm = self.carrier.arm
        joints = [
            (home, joint.velocity, joint.acceleration, joint.jerk)
            for home, joint in zip(arm.home, arm.joints, strict=True)
        ]
        return _core.ArmHolder(
            self.carrier.core,
            np.array(joints, float),
            (self.room.low, self.room.high),
            self.reach_along,
            (self.speed, self.turn_speed),
        )

    def start(
        self, T_world_magnet: Float[np.ndarray, "4 4"], near: Float[np.ndarray, " j"] | None = None
    ) -> Held:
        """The arm at rest with the magnet at a pose; joint angles nearest to `near` or its home.

        Raises:
            InputError: If it cannot hold the magnet there, see `reach`.
        """
        rolled = self._core.rolled(np.asarray(T_world_magnet, float))
        angles = reach(self.carrier, rolled, near)
        return Held(magnet_at(self.carrier, angles), np.zeros_like(angles), angles)

    def move(self, held: Held, T_world_magnet: Float[np.ndarray, "4 4"], dt: float) -> Held:
        """The magnet a time `dt` [s] later, on its way to a pose, in small steps if need be.

        Raises:
            InputError: If the magnet is not held by an arm of as many joints.
        """
        count = self.carrier.arm.num_joints
        if not len(held.angles) == len(held.velocity) == count:
            raise InputError(
                f"A magnet held by {len(held.angles)} joints for arm {self.carrier.arm.name}. "
                f"Allowed: {count}, as `start` gives it."
            )
        goal = np.asarray(T_world_magnet, float)
        return Held(*self._core.move_on(held.T_world_magnet, held.velocity, held.angles, goal, dt))
