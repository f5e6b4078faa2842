"""Where to hold a magnet so that the capsule feels a wanted force and torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import aim_magnet
from vrcaps.errors import InputError, require
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.internal import InternalMagnet, magnet_rows
from vrcaps.magnet.sources import MAGNETIC_CONSTANT, magnet_pose
from vrcaps.units import CM

if TYPE_CHECKING:
    from jaxtyping import Float

_EVERYWHERE = (-math.inf, -math.inf, -math.inf), (math.inf, math.inf, math.inf)
_ROUNDS = 30


@dataclass(frozen=True)
class Room:
    """Where the magnet's centre may be.

    Attributes:
        low: Least x, y, z in the world [m], such as the height of the patient's skin and the
            magnet's radius above it.
        high: Largest x, y, z [m].
        apart: Least distance from the capsule [m]: nearer, the pull grows beyond control.
    """

    low: tuple[float, float, float] = _EVERYWHERE[0]
    high: tuple[float, float, float] = _EVERYWHERE[1]
    apart: float = 10.0 * CM

    def __post_init__(self) -> None:
        if not all(low <= high for low, high in zip(self.low, self.high, strict=True)):
            raise InputError(f"A room from {self.low} to {self.high} m. Allowed: low up to high.")
        require(0.0 < self.apart < math.inf, "Room's apart", self.apart, "above 0 m")

    def admit(self, T_world_magnet: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """The pose, moved into the box; the distance to the capsule is not minded."""
        inside = np.array(T_world_magnet, float)
        inside[:3, 3] = self.clip(inside[:3, 3])
        return inside

    def clip(self, place: Float[np.ndarray, " 3"]) -> list[float]:
        """The place in the box that is nearest [m]; in plain numbers, for loops' sake."""
        axes = zip(place.tolist(), self.low, self.high, strict=True)
        return [min(max(x, low), high) for x, low, high in axes]


@dataclass(frozen=True)
class Wish:
    """What the capsule is to feel, and how much it matters.

    Attributes:
        force: Force [N], in the world.
        torque: Torque about the capsule's origin [N·m], in the world.
        force_weight: What a newton too much counts, by direction [1/N].
        torque_weight: What a newton metre too much counts [1/(N·m)].
        stay: What it counts to move the magnet by its distance, or to turn it by a radian.
    """

    force: Sequence[float]
    torque: Sequence[float] = (0.0, 0.0, 0.0)
    force_weight: Sequence[Sequence[float]] = field(default_factory=(100.0 * np.eye(3)).tolist)
    torque_weight: float = 1000.0
    stay: float = 1e-3


@dataclass(frozen=True)
class Aimed:
    """A pose of the magnet and what the capsule feels of all sources then.

    Attributes:
        T_world_magnet: The pose.
        force: Force [N], in the world.
        torque: Torque about the capsule's origin [N·m], in the world.
        hold: Largest torque that the field there has for the capsule's magnets [N·m].
    """

    T_world_magnet: Float[np.ndarray, "4 4"]
    force: Float[np.ndarray, " 3"]
    torque: Float[np.ndarray, " 3"]
    hold: float


class Aim:
    """Finds poses of one magnet among sources, for a capsule with magnets."""

    def __init__(
        self, sources: SourceSet, magnets: Sequence[InternalMagnet], room: Room, *, index: int = 0
    ) -> None:
        """Takes the sources, the capsule's magnets, and which source is moved.

        Raises:
            InputError: If the capsule has no magnet or there is no such source.
        """
        if not magnets:
            raise InputError(
                "The capsule holds no magnet. Give a device with [[magnets]], such as magnetic."
            )
        count = len(sources.sources)
        require(0 <= index < count, "index", index, f"0 to {count - 1}")
        self.sources, self.room, self._index = sources, room, index
        self._rows = magnet_rows(magnets)
        self._all = _Wanted(room)

    @property
    def moment(self) -> Float[np.ndarray, " 3"]:
        """Sum of the capsule's moments, in its frame [A·m²]."""
        return self._rows[:, 3:].sum(axis=0)

    def farthest(self, force: float) -> float:
        """Distance from which the magnet can just pull with a force [N]; at least with 1 mN.

        That of two coaxial dipoles, F = 3 μ₀ m₁ m₂/(2π r⁴).
        """
        strong = float(getattr(self.sources.sources[self._index], "moment", 1.0))
        size = float(np.linalg.norm(self.moment))
        return (1.5 * MAGNETIC_CONSTANT * strong * size / (np.pi * max(force, 1e-3))) ** 0.25

    def solve(
        self,
        wish: Wish,
        T_world_capsule: Float[np.ndarray, "4 4"],
        start: Float[np.ndarray, "4 4"],
        *,
        rounds: int = _ROUNDS,
    ) -> Aimed:
        """The pose near `start` whose wrench on a capsule there is nearest to the wish.

        Damped least squares (Levenberg 1944, Marquardt 1963) over place and direction of the
        magnet, within the room. Force and heading of a capsule can be chosen freely with a single
        magnet (Mahoney and Abbott, Int. J. Robot. Res. 35, 2016): the heading is that of
        `T_world_capsule` where no torque is wished.

        Args:
            wish: What the capsule is to feel.
            T_world_capsule: Where the capsule is to feel it.
            start: Pose of the magnet to begin with; its turn about its axis is kept.
            rounds: Most steps.
        """
        self._all.wish = wish
        pose, force, torque, hold = aim_magnet(
            self.sources.core, self._index, self._rows, T_world_capsule, start, self._all, rounds
        )
        return Aimed(pose, np.array(force), np.array(torque), hold)

    def guess(
        self,
        T_world_capsule: Float[np.ndarray, "4 4"],
        direction: Float[np.ndarray, " 3"],
        force: float,
    ) -> Float[np.ndarray, "4 4"]:
        """A pose to begin with: along a direction from the capsule, the field along its moment.

        A dipole m̂ ∝ (3/2 r̂ r̂ᵀ − 1) b̂ has its field along b̂ at −r; the distance is `farthest`.

        Args:
            T_world_capsule: The capsule.
            direction: From it to the magnet, in the world; need not be of unit length.
            force: Wished size of the force [N].
        """
        away = np.asarray(direction, float) / np.linalg.norm(direction)
        moment = T_world_capsule[:3, :3] @ self.moment
        axis = 1.5 * away * (away @ moment) - moment
        distance = max(self.farthest(force), self.room.apart)
        return self.room.admit(magnet_pose(T_world_capsule[:3, 3] + distance * away, axis))


class _Wanted:
    """Wish and room together, as the core reads them."""

    def __init__(self, room: Room) -> None:
        self.low, self.high, self.apart = room.low, room.high, room.apart
        self.wish = Wish((0.0, 0.0, 0.0))

    def __getattr__(self, name: str) -> object:
        return getattr(self.wish, name)
