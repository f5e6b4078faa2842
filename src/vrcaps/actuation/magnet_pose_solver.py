"""Inverse magnetic actuation: the magnet pose that exerts a desired wrench on the capsule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import check_fields
from vrcaps.core.units import CM
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import MAGNETIC_CONSTANT, InternalMagnet, magnet_pose, magnet_rows

if TYPE_CHECKING:
    from jaxtyping import Float

_UNBOUNDED = (-math.inf, -math.inf, -math.inf), (math.inf, math.inf, math.inf)
_MAX_ITERATIONS = 30


@dataclass(frozen=True)
class Workspace:
    """Allowed positions of the external magnet's center: a box, and a distance from the capsule.

    Attributes:
        low: Minimum x, y, z in the world [m], such as the height of the patient's skin plus the
            magnet's radius.
        high: Maximum x, y, z [m].
        min_distance: Minimum distance from the capsule [m]; closer, the pull is uncontrollable.
    """

    low: tuple[float, float, float] = _UNBOUNDED[0]
    high: tuple[float, float, float] = _UNBOUNDED[1]
    min_distance: float = 10.0 * CM

    def __post_init__(self) -> None:
        check_fields(self, of="Workspace")
        if not all(low <= high for low, high in zip(self.low, self.high, strict=True)):
            raise InputError(
                f"The workspace is from {self.low} to {self.high} m. Allowed: low up to high."
            )
        is_valid = 0.0 < self.min_distance < math.inf
        require(is_valid, "Workspace's min_distance", self.min_distance, "above 0 m")

    def clamp_pose(self, T_world_magnet: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Move a pose into the box; the distance to the capsule is ignored."""
        inside = np.array(T_world_magnet, float)
        inside[:3, 3] = self.clamp(inside[:3, 3])
        return inside

    def clamp(self, position: Float[np.ndarray, " 3"]) -> list[float]:
        """Nearest position in the box [m], as floats, which are faster in loops."""
        axes = zip(position.tolist(), self.low, self.high, strict=True)
        return [min(max(x, low), high) for x, low, high in axes]


@dataclass(frozen=True)
class WrenchTarget:
    """Desired wrench on the capsule, and weights of its components.

    Attributes:
        force: Force [N], in the world.
        torque: Torque about the capsule's origin [N·m], in the world.
        force_weight: Weight of the force error, by direction [1/N].
        torque_weight: Weight of the torque error [1/(N·m)].
        motion_weight: Weight of moving the magnet by its distance, or rotating it by a radian.
    """

    force: Sequence[float]
    torque: Sequence[float] = (0.0, 0.0, 0.0)
    force_weight: Sequence[Sequence[float]] = field(default_factory=(100.0 * np.eye(3)).tolist)
    torque_weight: float = 1000.0
    motion_weight: float = 1e-3


@dataclass(frozen=True)
class MagnetPoseSolution:
    """Magnet pose, and the wrench of all sources on the capsule there.

    Attributes:
        T_world_magnet: Pose of the magnet.
        force: Force [N], in the world.
        torque: Torque about the capsule's origin [N·m], in the world.
        max_torque: Maximum torque that the field there can exert on the capsule's magnets [N·m].
    """

    T_world_magnet: Float[np.ndarray, "4 4"]
    force: Float[np.ndarray, " 3"]
    torque: Float[np.ndarray, " 3"]
    max_torque: float


class MagnetPoseSolver:
    """Solver for the pose of one magnet among sources, for a capsule with magnets."""

    def __init__(
        self,
        sources: SourceSet,
        magnets: Sequence[InternalMagnet],
        workspace: Workspace,
        *,
        index: int = 0,
    ) -> None:
        """Create a solver for the moved source `index` among the sources.

        Raises:
            InputError: If the capsule has no magnet or there is no such source.
        """
        if not magnets:
            raise InputError(
                "The capsule contains no magnet. Give a device with [[magnets]], such as magnetic."
            )
        count = len(sources.sources)
        require(0 <= index < count, "index", index, f"0 to {count - 1}")
        self.sources = sources
        self.workspace = workspace
        self._index = index
        self._rows = magnet_rows(magnets)

    @property
    def moment(self) -> Float[np.ndarray, " 3"]:
        """Sum of the capsule's moments, in its frame [A·m²]."""
        return self._rows[:, 3:].sum(axis=0)

    def max_distance(self, force: float) -> float:
        """Maximum distance [m] at which the magnet exerts a force [N], of at least 1 mN.

        Computed for two coaxial dipoles, F = 3 μ₀ m₁ m₂/(2π r⁴).
        """
        moment = float(getattr(self.sources.sources[self._index], "moment", 1.0))
        inside = float(np.linalg.norm(self.moment))
        product = 1.5 * MAGNETIC_CONSTANT * moment * inside
        return (product / (np.pi * max(force, 1e-3))) ** 0.25

    def solve(
        self,
        target: WrenchTarget,
        T_world_capsule: Float[np.ndarray, "4 4"],
        start: Float[np.ndarray, "4 4"],
        *,
        max_iterations: int = _MAX_ITERATIONS,
    ) -> MagnetPoseSolution:
        """Find the pose near `start` whose wrench on the capsule is nearest to the target.

        Damped least squares (Levenberg 1944, Marquardt 1963) over position and direction of the
        magnet, within the workspace. A single magnet can set force and heading of a capsule
        independently (Mahoney and Abbott, Int. J. Robot. Res. 35, 2016): the heading is that of
        `T_world_capsule` if the target torque is zero.

        Args:
            target: Desired wrench on the capsule.
            T_world_capsule: Pose of the capsule.
            start: Initial pose of the magnet; its rotation about its own axis is kept.
            max_iterations: Maximum number of iterations.
        """
        pose, force, torque, max_torque = _core.solve_magnet_pose(
            self.sources.core,
            self._index,
            self._rows,
            T_world_capsule,
            start,
            target,
            self.workspace,
            max_iterations,
        )
        return MagnetPoseSolution(pose, np.array(force), np.array(torque), max_torque)

    def initial_guess(
        self,
        T_world_capsule: Float[np.ndarray, "4 4"],
        direction: Float[np.ndarray, " 3"],
        force: float,
    ) -> Float[np.ndarray, "4 4"]:
        """Initial pose along a direction from the capsule, with the field along its moment.

        A dipole m̂ ∝ (3/2 r̂ r̂ᵀ − 1) b̂ has its field along b̂ at −r; the distance is
        `max_distance`.

        Args:
            T_world_capsule: Pose of the capsule.
            direction: Direction from the capsule to the magnet, in the world; any length.
            force: Desired magnitude of the force [N].
        """
        away = np.asarray(direction, float) / np.linalg.norm(direction)
        moment = T_world_capsule[:3, :3] @ self.moment
        axis = 1.5 * away * (away @ moment) - moment
        distance = max(self.max_distance(force), self.workspace.min_distance)
        pose = magnet_pose(T_world_capsule[:3, 3] + distance * away, axis)
        return self.workspace.clamp_pose(pose)
