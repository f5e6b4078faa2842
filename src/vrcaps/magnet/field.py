"""Flux density, gradient and field lines of sources, and the wrench on a capsule in their field.

    field(sources, points) -> (flux_density, flux_gradient)

`flux_gradient[n, i, j]` is ∂B_i/∂x_j. Sums run in the order of the sources for any number of
threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.core.geometry import quaternion_from_matrix, unit
from vrcaps.magnet.sources import (
    Block,
    InternalMagnet,
    Magnet,
    Source,
    check_pose,
    magnet_rows,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    Points = Float[np.ndarray, "n 3"]

_FAULTS = {
    1: "is outside a field map. Give a map that covers it",
    2: "is in a dipole, on a wire or on the rim of a magnet. Move it away",
}

_MAX_STEPS = 100_000
_ABOVE = 1e-3
"""Height above a magnet's face at which its lines start, as a fraction of its length: points on the
face itself would count as inside."""


class SourceSet:
    """Sources held by the compiled core, which can be moved and evaluated repeatedly.

    Attributes:
        sources: The sources as passed in; `move` does not change them.
        core: The core's sources, evaluated by steps of the world.
    """

    def __init__(self, sources: Sequence[Source]) -> None:
        self.sources = tuple(sources)
        self.core = _core.FieldSources()
        counts = [source.add_to(self.core) for source in self.sources]
        self._first = np.concatenate([[0], np.cumsum(counts)]).astype(int)
        self._counts = np.diff(self._first)

    def move(self, index: int, T_world_magnet: Float[np.ndarray, "4 4"]) -> None:
        """Move one source to another pose.

        Raises:
            InputError: If there is no such source, or the pose is not rigid.
        """
        if not 0 <= index < len(self.sources):
            raise InputError(f"No source {index}. Allowed: 0 to {len(self.sources) - 1}.")
        check_pose("T_world_magnet", T_world_magnet)
        for k in range(self._first[index], self._first[index + 1]):
            self.core.set_pose(k, np.asarray(T_world_magnet, float))

    def spread(self, rows: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "p c"]:
        """Expand rows per source to rows per part of a source in the core."""
        if len(self.sources) == self._first[-1]:  # one part each, as for magnets
            return rows
        return np.repeat(rows, self._counts, axis=0)

    def field(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Flux density [T] and its gradient [T/m] at points of the world [m].

        Raises:
            InputError: If a point is not finite, at a dipole, on a wire or on the rim of a magnet,
                or outside a field map.
        """
        points = np.ascontiguousarray(points, float)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(
                f"Points have shape {points.shape}. Allowed: n rows of 3 finite numbers."
            )
        flux, gradient, faults = self.core.field(points)
        _check_faults(faults, points)
        return flux, gradient

    def wrench(
        self, magnets: Sequence[InternalMagnet], Ts_world_capsule: Float[np.ndarray, "*n 4 4"]
    ) -> tuple[Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n 3"]]:
        """Force [N] and torque about the capsule's origin [N·m], in the world frame.

        F = ∇(m·B) and N = m × B + arm × F (Jackson 1999, eq. 5.69, 5.71), summed over the capsule's
        magnets at their positions. Forces between magnets of one capsule, which cancel, and forces
        on steel are neglected.

        Raises:
            InputError: As in `field`, at the position of a magnet; or if a pose is not finite.
        """
        poses = np.asarray(Ts_world_capsule, float)
        if poses.shape[-2:] != (4, 4) or not np.isfinite(poses).all():
            raise InputError(f"Poses have shape {poses.shape}. Allowed: finite 4 x 4 matrices.")
        batch = poses.shape[:-2]
        poses = poses.reshape(-1, 4, 4)
        quaternions = quaternion_from_matrix(poses[:, :3, :3])
        rows = np.concatenate([poses[:, :3, 3], quaternions], axis=1)
        wrench, faults = self.core.wrench(magnet_rows(magnets), rows)
        _check_faults(faults, poses[:, :3, 3])
        return wrench[:, :3].reshape(*batch, 3), wrench[:, 3:].reshape(*batch, 3)


def field(
    sources: Sequence[Source], points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Flux density [T] and its gradient ∂B_i/∂x_j [T/m] at points of the world [m].

    Raises:
        InputError: See `SourceSet.field`.
    """
    return SourceSet(sources).field(points)


def wrench(
    sources: Sequence[Source],
    magnets: Sequence[InternalMagnet],
    T_world_capsule: Float[np.ndarray, "*n 4 4"],
) -> tuple[Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n 3"]]:
    """Force [N] and torque [N·m] on a capsule, see `SourceSet.wrench`.

    Raises:
        InputError: See `SourceSet.wrench`.
    """
    return SourceSet(sources).wrench(magnets, T_world_capsule)


def _check_faults(faults: np.ndarray, points: np.ndarray) -> None:
    if faults.any():
        worst = int(np.argmax(faults))
        raise InputError(f"Point {worst} at {points[worst]} m {_FAULTS[int(faults[worst])]}.")


def field_lines(
    sources: Sequence[Source],
    starts: Float[np.ndarray, "n 3"],
    *,
    step: float,
    goes_on: Callable[[Points], Bool[np.ndarray, " n"]],
    most: int = 2000,
) -> list[Float[np.ndarray, "k 3"]]:
    """Trace lines along the flux density, dx/ds = B/|B|, by the classical Runge-Kutta method.

    Args:
        sources: Sources of the field.
        starts: First point of each line in the world [m].
        step: Length of a step [m].
        goes_on: Mask of the points [m] that a line may pass; it ends at the first other point.
        most: Maximum number of steps of a line.

    Raises:
        InputError: If a number is out of range, or a point is where the field is undefined, see
            `SourceSet.field`.
    """
    require(0.0 < step < np.inf, "step", step, "above 0 m")
    require(1 <= most <= _MAX_STEPS, "most", most, f"1 to {_MAX_STEPS}")
    source_set = SourceSet(sources)
    points = np.array(starts, float).reshape(-1, 3)
    lines = [[point] for point in points]
    going = np.arange(len(points))
    for _ in range(most):
        points = _stepped(source_set, points, step)
        for line, point in zip(going, points, strict=True):
            lines[line].append(point)
        stays = goes_on(points)
        going, points = going[stays], points[stays]
        if not len(going):
            break
    return [np.array(line) for line in lines]


def _stepped(source_set: SourceSet, points: Points, step: float) -> Points:
    """Advance points one step along the field by the fourth-order Runge-Kutta method."""

    def along(positions: Points) -> Points:
        return unit(source_set.field(positions)[0])

    first = along(points)
    second = along(points + 0.5 * step * first)
    third = along(points + 0.5 * step * second)
    fourth = along(points + step * third)
    return points + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


def magnet_lines(
    magnet: Magnet, *, reach: float, step: float, rings: int = 5, meridians: int = 8
) -> list[Float[np.ndarray, "k 3"]]:
    """Field lines outside a magnet's bounding cylinder, in its own frame, from the north face.

    They start where they divide the face into rings of equal area, and so of nearly equal flux. If
    the field is axially symmetric, one meridian is traced and rotated.

    Args:
        magnet: The magnet; its pose is ignored.
        reach: Distance from its center at which a line ends [m].
        step: Length of a step [m].
        rings: Number of lines per meridian.
        meridians: Number of half planes around the axis.

    Raises:
        InputError: If a number is out of range.
    """
    require(1 <= rings <= 100, "rings", rings, "1 to 100")
    require(1 <= meridians <= 100, "meridians", meridians, "1 to 100")
    radius, half = (0.5 * extent for extent in magnet.bounds)
    meridian = np.zeros((rings, 3))
    meridian[:, 0] = radius * np.sqrt((np.arange(rings) + 0.5) / rings)
    meridian[:, 2] = half * (1.0 + _ABOVE)

    def is_outside(points: Points) -> Bool[np.ndarray, " n"]:
        is_in = (np.hypot(points[:, 0], points[:, 1]) < radius) & (np.abs(points[:, 2]) < half)
        return ~is_in & (np.linalg.norm(points, axis=1) < reach)

    def turned(lines: Sequence[np.ndarray]) -> list[np.ndarray]:
        angles = 2.0 * np.pi * np.arange(meridians) / meridians
        turns = []
        for cosine, sine in zip(np.cos(angles), np.sin(angles), strict=True):
            turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
            turns += [line @ turn.T for line in lines]
        return turns

    source = replace(magnet, T_world_magnet=np.eye(4))
    if isinstance(magnet, Block) or getattr(magnet, "magnetization", "axial") != "axial":
        starts = np.array(turned([meridian])).reshape(-1, 3)
        return field_lines([source], starts, step=step, goes_on=is_outside)
    return turned(field_lines([source], meridian, step=step, goes_on=is_outside))
