"""Kinematic wall displacement: a narrow wall is displaced by the capsule's shell, without forces.

Within two radii of the body's axis, space is stretched away from it: a point at a distance d moves
to d' = R + R ((d - d₀) / (2R - d₀))^p, where d₀ is the wall's minimum distance from the axis and
p = (2R - d₀) / R, with which the map is smooth at its boundary. It is one to one, so the wall never
self-intersects, touches the shell where it was nearest, and is unchanged where the capsule has
clearance. `vrcaps.world.world` contains the mechanics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.transforms import invert, transform_points
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

_LOOKS = 17
"""Number of points of the axis at which the distance to the wall is measured."""

_LEAST = 1e-6
"""Distance from the axis below which the direction is undefined [m]."""


@dataclass(frozen=True)
class WallDisplacement:
    """Wall displaced by a capsule.

    Attributes:
        model: The lumen and the capsule that moves in it.
        shown: Model whose wall is displaced; has the same triangles, such as a clean twin.
    """

    model: Model
    shown: Model

    def vertices_world(
        self, T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "n 3"] | None:
        """Vertices of the displaced wall [m]; None if the shell has clearance."""
        radius = self.model.device.radius
        low, high, least = self._axis(T_world_capsule)
        if least >= radius:
            return None
        reach = 2.0 * radius
        rest = self.shown.vertices_world
        near = np.flatnonzero(_near(rest, T_world_capsule[:3, 3], max(high, -low) + reach))
        local = transform_points(invert(T_world_capsule), rest[near])
        local[:, 2] -= np.clip(local[:, 2], low, high)
        distance = np.linalg.norm(local, axis=1)
        moved = (distance < reach) & (distance > _LEAST)
        near, distance = near[moved], distance[moved]
        fraction = np.clip((distance - least) / (reach - least), 0.0, 1.0)
        further = radius + radius * fraction ** ((reach - least) / radius) - distance
        vertices = rest.copy()
        outward = local[moved] @ T_world_capsule[:3, :3].T / distance[:, None]
        vertices[near] += further[:, None] * outward
        return vertices

    def _axis(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> tuple[float, float, float]:
        """Part of the body's axis in the lumen, and its minimum distance to the wall [m].

        An end of the axis may be outside in a bend too sharp for the body.
        """
        device = self.model.device
        half = device.length / 2.0 - device.radius
        along = np.linspace(-half, half, _LOOKS)
        points = T_world_capsule[:3, 3] + along[:, None] * T_world_capsule[:3, 2]
        free = np.asarray(self.model.wall.signed_distance(points), float)
        middle = _LOOKS // 2
        outside = np.flatnonzero(free <= 0.0)
        first = max((k + 1 for k in outside if k < middle), default=0)
        last = min((k - 1 for k in outside if k > middle), default=_LOOKS - 1)
        least = max(float(free[first : last + 1].min()), 0.0)
        return float(along[first]), float(along[last]), least


def _near(
    points: Float[np.ndarray, "n 3"], center: Float[np.ndarray, " 3"], reach: float
) -> np.ndarray:
    """Mask of the points in a box around a center."""
    return np.all(np.abs(points - center) < reach, axis=1)
