"""An arm that holds a magnet, with the limits of its joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.magnet.arm.carrier import Carrier, clearances, flange_at, magnet_at, reach
from vrcaps.magnet.arm.kinematics import nearest
from vrcaps.magnet.steering.aim import Room
from vrcaps.magnet.steering.holder import Held
from vrcaps.magnet.steering.turn import at_most, cross, length, rotation_vector, turned

if TYPE_CHECKING:
    from jaxtyping import Float

_UPRIGHT = 0.2
"""Sine of an angle below which a direction along the magnet's axis says nothing about its turn."""

_FARTHEST, _MOST_TURN = 0.03, 0.3
"""How far ahead on its way the arm looks [m, rad]."""

_SLACK = 5e-3
"""How far out of the room the joints may lead the magnet on its way [m]."""

_JUMP = 0.5
"""A pose whose joint angles are farther than this from those of now [rad] is on another branch."""


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
    def _limits(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        joints = self.carrier.arm.joints
        table = np.array([[j.velocity, j.acceleration, j.jerk] for j in joints]).T
        return table[0], table[1], table[2]

    def start(
        self, T_world_magnet: Float[np.ndarray, "4 4"], near: Float[np.ndarray, " j"] | None = None
    ) -> Held:
        """The arm at rest with the magnet at a pose; joint angles nearest to `near` or its home.

        Raises:
            InputError: If it cannot hold the magnet there, see `reach`.
        """
        pose = np.asarray(T_world_magnet, float)
        angles = reach(self.carrier, self._rolled(pose, pose), near)
        return self._held(angles, np.zeros_like(angles), "")

    def move(self, held: Held, T_world_magnet: Float[np.ndarray, "4 4"], dt: float) -> Held:
        """The magnet a time `dt` [s] later, on its way to a pose."""
        at = held.angles
        goal = self.room.admit(T_world_magnet)
        limit = "" if (goal[:3, 3] == T_world_magnet[:3, 3]).all() else "room"
        goal = _part_way(held.T_world_magnet, self._rolled(goal, held.T_world_magnet))
        wanted = nearest(self.carrier.arm, flange_at(self.carrier, goal), at)
        if np.isnan(wanted[0]) or np.abs(wanted - at).max() > _JUMP:
            wanted, limit = at, "reach"
        velocity = self._velocity(wanted - at, held.velocity, dt, self._share(held, goal))
        angles = at + dt * velocity
        _, acceleration, _ = self._allowed(dt)
        stop = angles + 0.5 * velocity * np.abs(velocity) / acceleration
        pair = np.array([angles, stop])
        poses = magnet_at(self.carrier, pair)
        blocked = self._blocked(pair, poses, held)
        if blocked:
            velocity = self._velocity(np.zeros_like(at), held.velocity, dt)
            return self._held(at + dt * velocity, velocity, blocked)
        if not limit and np.abs(wanted - angles).max() > 1e-3:
            limit = "speed"
        return Held(poses[0], velocity, angles, limit)

    def _rolled(
        self, T_world_magnet: Float[np.ndarray, "4 4"], now: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "4 4"]:
        """The pose, turned about the magnet's axis until the flange points where it is to.

        Where that is along the axis, the flange points as it does now.
        """
        axis = T_world_magnet[:3, 2]
        along = self.carrier.T_magnet_flange[:3, 2]
        flange, held = T_world_magnet[:3, :3] @ along, now[:3, :3] @ along
        x, y = (v - axis * (axis @ v) for v in (flange, np.array(self.reach_along)))
        if length(y) < _UPRIGHT:
            y = held - axis * (axis @ held)
        if length(x) < 1e-9 or length(y) < 1e-9:
            return T_world_magnet
        rolled = T_world_magnet.copy()
        angle = math.atan2(float(axis @ cross(x, y)), float(x @ y))
        rolled[:3, :3] = turned(angle * axis, T_world_magnet[:3, :3])
        return rolled

    def _blocked(
        self, angles: Float[np.ndarray, "2 j"], poses: Float[np.ndarray, "2 4 4"], held: Held
    ) -> str:
        """What is in the way of the next angles and of those at which the arm could stop."""
        if clearances(self.carrier, angles).min() < 0.0:
            return "touch"
        # On the way from one pose in the room to another the joints may lead the magnet out of it.
        out = max(self._outside(place) for place in poses[:, :3, 3])
        if out > _SLACK and out > self._outside(held.T_world_magnet[:3, 3]):
            return "room"
        return ""

    def _share(self, held: Held, goal: Float[np.ndarray, "4 4"]) -> float:
        """Largest part of the way a second that keeps the magnet's own speeds [1/s]."""
        now = held.T_world_magnet
        way = math.dist(goal[:3, 3], now[:3, 3])
        turn = length(rotation_vector(goal[:3, :3] @ now[:3, :3].T))
        return min(self.speed / max(way, 1e-9), self.turn_speed / max(turn, 1e-9))

    def _outside(self, place: Float[np.ndarray, " 3"]) -> float:
        """How far a place is out of the room [m]."""
        bounds = zip(place.tolist(), self.room.low, self.room.high, strict=True)
        return math.hypot(*(max(low - x, x - high, 0.0) for x, low, high in bounds))

    def _allowed(self, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Speeds, and accelerations that may turn round within a step, for their jerk's sake."""
        speed, acceleration, jerk = self._limits
        return speed, np.minimum(acceleration, 0.5 * jerk * dt), jerk

    def _velocity(
        self,
        way: Float[np.ndarray, " j"],
        velocity: Float[np.ndarray, " j"],
        dt: float,
        most_share: float = math.inf,
    ) -> Float[np.ndarray, " j"]:
        """Joint speeds of the next step: all joints keep step, and can stop where they are to."""
        speed, acceleration, _ = self._allowed(dt)
        size = np.abs(way)
        a = acceleration * dt
        most = np.minimum(speed, np.sqrt(a * a + 2.0 * acceleration * size) - a)
        share = min(1.0 / dt, most_share, float((most / np.maximum(size, 1e-12)).min()))
        return velocity + np.clip(share * way - velocity, -a, a)

    def _held(self, angles: np.ndarray, velocity: np.ndarray, limit: str) -> Held:
        return Held(magnet_at(self.carrier, angles), velocity, angles, limit)


def _part_way(
    start: Float[np.ndarray, "4 4"], goal: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "4 4"]:
    """The goal, or where the way there begins if it is far."""
    part = goal.copy()
    part[:3, 3] = start[:3, 3] + at_most(goal[:3, 3] - start[:3, 3], _FARTHEST)
    turn = rotation_vector(goal[:3, :3] @ start[:3, :3].T)
    if length(turn) > _MOST_TURN:
        part[:3, :3] = turned(at_most(turn, _MOST_TURN), start[:3, :3])
    return part
