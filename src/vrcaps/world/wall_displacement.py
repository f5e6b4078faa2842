"""Displacement of a wall that gives way to the capsule's shell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import invert, transform_points
from vrcaps.world.closure import LumenClosure, closure_of
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_LOOKS = 17
"""Number of points of the axis at which the distance to the wall is measured."""

_MIN_DISTANCE = 1e-6
"""Distance from the axis below which the direction is undefined [m]."""


@dataclass(frozen=True)
class WallDisplacement:
    """Kinematic displacement: a narrow wall gives way to the capsule's shell, without forces.

    Within two radii of the body's axis, space is stretched away from it: a point at a distance d
    moves to d' = R + R ((d - d₀) / (2R - d₀))^p, where d₀ is the wall's minimum distance from the
    axis and p = (2R - d₀) / R, with which the map is smooth at its boundary. It is one to one, so
    the wall never self-intersects, touches the shell where it was nearest, and is unchanged where
    the capsule has clearance. `vrcaps.world.world` contains the mechanics.

    Attributes:
        model: The lumen and the capsule that moves in it.
        shown: Model whose wall is displaced; has the same triangles, such as a clean twin.
    """

    model: Model
    shown: Model

    def vertices_world(
        self, T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "n 3"] | None:
        """Vertices of the displaced wall [m]; None for a wall at rest."""
        low, high, least = self._axis(T_world_capsule)
        if self._closure is not None:
            vertices = self.shown.vertices_world.copy()
            moved, closed = self._closure.close(
                T_world_capsule,
                self.model.device.length / 2.0,
                self.model.device.radius,
            )
            vertices[moved] = closed
            return self._yielding((vertices, moved), T_world_capsule, (low, high), None)
        if least >= self.model.device.radius:
            return None
        vertices, moved = self.shown.vertices_world.copy(), np.empty(0, int)
        return self._yielding((vertices, moved), T_world_capsule, (low, high), least)

    @cached_property
    def _closure(self) -> LumenClosure | None:
        return closure_of(self.shown)

    @cached_property
    def _rows_at_rest(self) -> Float[np.ndarray, "3 n"]:
        """Coordinates of the vertices at rest, each in a contiguous row [m]."""
        return np.ascontiguousarray(self.shown.vertices_world.T)

    def _yielding(
        self,
        wall: tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " k"]],
        T_world_capsule: Float[np.ndarray, "4 4"],
        ends: tuple[float, float],
        least: float | None,
    ) -> Float[np.ndarray, "n 3"]:
        """Move vertices off the shell.

        Args:
            wall: Vertices, changed in place, and which of them are not at rest.
            T_world_capsule: Pose of the capsule.
            ends: Part of the body's axis in the lumen [m].
            least: Distance of the vertices to the axis if known [m].
        """
        (vertices, displaced), radius, (low, high) = wall, self.model.device.radius, ends
        reach = 2.0 * radius
        box = T_world_capsule[:3, 3], max(high, -low) + reach
        is_candidate = np.zeros(len(vertices), bool)
        is_candidate[_near(self._rows_at_rest, *box)] = True
        is_candidate[displaced] = True
        near = np.flatnonzero(is_candidate)
        near = near[_near(vertices[near].T, *box)]
        local = transform_points(invert(T_world_capsule), vertices[near])
        local[:, 2] -= np.clip(local[:, 2], low, high)
        distance = np.linalg.norm(local, axis=1)
        moved = (distance < reach) & (distance > _MIN_DISTANCE)
        near, distance = near[moved], distance[moved]
        if least is None:
            least = float(distance.min(initial=reach))
        if least >= radius:
            return vertices
        fraction = np.clip((distance - least) / (reach - least), 0.0, 1.0)
        further = radius + radius * fraction ** ((reach - least) / radius) - distance
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
    rows: Float[np.ndarray, "3 n"], center: Float[np.ndarray, " 3"], reach: float
) -> Int[np.ndarray, " k"]:
    """Indices of the points, given by coordinate, in a box around a center, in order."""
    near = np.flatnonzero(np.abs(rows[0] - center[0]) < reach)
    for row, middle in zip(rows[1:], center[1:], strict=True):
        near = near[np.abs(row[near] - middle) < reach]
    return near
