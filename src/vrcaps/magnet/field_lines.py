"""Field lines: curves that follow the flux density of magnetic sources."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.geometry import unit
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import Cylinder, Source

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    Points = Float[np.ndarray, "n 3"]

_MAX_STEPS = 100_000
_ABOVE = 1e-3
"""Height above a magnet's face at which its lines start, as a fraction of its length: points on the
face itself would count as inside."""


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
    field = SourceSet(sources)
    points = np.array(starts, float).reshape(-1, 3)
    lines = [[point] for point in points]
    going = np.arange(len(points))
    for _ in range(most):
        points = _stepped(field, points, step)
        for line, point in zip(going, points, strict=True):
            lines[line].append(point)
        stays = goes_on(points)
        going, points = going[stays], points[stays]
        if not len(going):
            break
    return [np.array(line) for line in lines]


def _stepped(field: SourceSet, points: Points, step: float) -> Points:
    """Advance points one step along the field by the fourth-order Runge-Kutta method."""

    def along(places: Points) -> Points:
        return unit(field.field(places)[0])

    first = along(points)
    second = along(points + 0.5 * step * first)
    third = along(points + 0.5 * step * second)
    fourth = along(points + step * third)
    return points + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)


def magnet_lines(
    magnet: Cylinder, *, reach: float, step: float, rings: int = 5, meridians: int = 8
) -> list[Float[np.ndarray, "k 3"]]:
    """Field lines outside a cylinder, in its own frame, starting from its north face.

    They start where they divide the face into rings of equal area, and so of nearly equal flux.
    The field is axially symmetric, so one meridian is traced and rotated.

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
    radius, half = 0.5 * magnet.diameter, 0.5 * magnet.length
    starts = np.zeros((rings, 3))
    starts[:, 0] = radius * np.sqrt((np.arange(rings) + 0.5) / rings)
    starts[:, 2] = half * (1.0 + _ABOVE)

    def is_outside(points: Points) -> Bool[np.ndarray, " n"]:
        is_in = (np.hypot(points[:, 0], points[:, 1]) < radius) & (np.abs(points[:, 2]) < half)
        return ~is_in & (np.linalg.norm(points, axis=1) < reach)

    source = Cylinder(magnet.diameter, magnet.length, magnet.remanence)
    lines = field_lines([source], starts, step=step, goes_on=is_outside)
    angles = 2.0 * np.pi * np.arange(meridians) / meridians
    turned = []
    for cosine, sine in zip(np.cos(angles), np.sin(angles), strict=True):
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        turned += [line @ rotation.T for line in lines]
    return turned
