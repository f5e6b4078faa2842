"""What holds a magnet: it is asked for a pose and answers with the pose it then has."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vrcaps.actuation.magnet_pose_solver import Room
from vrcaps.actuation.vectors import at_most, length, rotation_vector, turned
from vrcaps.errors import require
from vrcaps.magnet.sources import check_pose

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Held:
    """A magnet as it is held at one instant.

    Attributes:
        T_world_magnet: Its pose.
        velocity: Of what moves it: the magnet [m/s, rad/s], in the world, or the arm's joints
            [rad/s].
        angles: The arm's joint angles [rad]; empty without an arm.
        limit: What kept it from the pose asked for: nothing, `speed` (or acceleration), `room`,
            `reach`, `touch` (of the arm by itself or the table).
    """

    T_world_magnet: Float[np.ndarray, "4 4"]
    velocity: Float[np.ndarray, " n"]
    angles: Float[np.ndarray, " j"] = field(default_factory=lambda: np.zeros(0))
    limit: str = ""


class Holder(Protocol):
    """An arm, or a hand without limits of reach."""

    @property
    def room(self) -> Room:
        """Where the magnet may be."""
        ...

    def start(self, T_world_magnet: Float[np.ndarray, "4 4"]) -> Held:
        """The magnet at rest at a pose; an error if it cannot be held there."""
        ...

    def move(self, held: Held, T_world_magnet: Float[np.ndarray, "4 4"], dt: float) -> Held:
        """The magnet a time `dt` [s] later, on its way to a pose; never an error, never a jump."""
        ...


@dataclass(frozen=True)
class FreeHolder:
    """A magnet without an arm, with limits of speed and acceleration only.

    Attributes:
        room: Where it may be.
        speed: Largest speed [m/s].
        acceleration: Largest acceleration [m/s²].
        turn_speed: Largest angular speed [rad/s].
        turn_acceleration: Largest angular acceleration [rad/s²].
    """

    room: Room = field(default_factory=Room)
    speed: float = 0.2
    acceleration: float = 2.0
    turn_speed: float = 2.0
    turn_acceleration: float = 20.0

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "turn_speed", "turn_acceleration"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, f"FreeHolder's {name}", value, "above 0")

    def start(self, T_world_magnet: Float[np.ndarray, "4 4"]) -> Held:
        """The magnet at rest at a pose.

        Raises:
            InputError: If the pose is not rigid or outside the room.
        """
        check_pose("T_world_magnet", T_world_magnet)
        place = np.asarray(T_world_magnet)[:3, 3]
        inside = np.all(place >= self.room.low) and np.all(place <= self.room.high)
        require(bool(inside), "The magnet's place", place, f"{self.room.low} to {self.room.high} m")
        return Held(np.array(T_world_magnet, float), np.zeros(6))

    def move(self, held: Held, T_world_magnet: Float[np.ndarray, "4 4"], dt: float) -> Held:
        """The magnet a time `dt` [s] later, on its way to a pose."""
        at, goal = held.T_world_magnet, self.room.admit(T_world_magnet)
        limit = "" if (goal[:3, 3] == T_world_magnet[:3, 3]).all() else "room"
        way = goal[:3, 3] - at[:3, 3]
        turn = rotation_vector(goal[:3, :3] @ at[:3, :3].T)
        linear = _approach(way, held.velocity[:3], self.speed, self.acceleration, dt)
        angular = _approach(turn, held.velocity[3:], self.turn_speed, self.turn_acceleration, dt)
        pose = np.eye(4)
        pose[:3, 3] = self.room.clip(at[:3, 3] + dt * linear)
        pose[:3, :3] = turned(dt * angular, at[:3, :3])
        left = math.dist(pose[:3, 3], goal[:3, 3]) + length(turn - dt * angular)
        if not limit and left > 1e-3:
            limit = "speed"
        return Held(pose, np.concatenate([linear, angular]), limit=limit)


def stopping_speed(way: float, acceleration: float, dt: float) -> float:
    """Largest speed [m/s] of the next step from which a stop within a way [m] is still possible.

    With steps of `dt`: v dt + v²/2a = way.
    """
    a = acceleration * dt
    return math.sqrt(a * a + 2.0 * acceleration * way) - a


def _approach(
    way: Float[np.ndarray, " 3"],
    velocity: Float[np.ndarray, " 3"],
    speed: float,
    acceleration: float,
    dt: float,
) -> Float[np.ndarray, " 3"]:
    """Velocity of the next step towards the end of a way, with limits on both its sizes."""
    far = length(way)
    aim = np.zeros(3)
    if far > 0.0:
        aim = way * (min(speed, far / dt, stopping_speed(far, acceleration, dt)) / far)
    return velocity + at_most(aim - velocity, acceleration * dt)
