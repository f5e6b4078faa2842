"""Displacement of a wall around the capsule: it yields to the shell, and a slack lumen closes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotate_vectors, smoothstep, transform_points
from vrcaps.mesh.point_blocks import PointBlocks, is_in_box
from vrcaps.mesh.untangle import relax
from vrcaps.world.lumen_closure import LumenClosure, closure_of
from vrcaps.world.model import Model, State

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.organ.surface import OrganSurface

_MIN_DISTANCE = 1e-6
"""Distance from the axis below which the direction is undefined [m]."""

_MAX_RELAXATIONS = 3
"""Maximum number of times that intersecting folds are relaxed and moved off the shell again."""


@dataclass(frozen=True)
class WallDisplacement:
    """Kinematic displacement: a narrow wall gives way to the capsule's shell, without forces.

    Within two radii of the body's axis, space is stretched away from it: a point at a distance d
    moves to d' = R + R ((d - d₀) / (2R - d₀))^p, where d₀ is the wall's minimum distance from the
    axis and p = (2R - d₀) / R, with which the map is smooth at its boundary. The map is one-to-one,
    so the wall never self-intersects, touches the shell where it was nearest, and is unchanged
    where the capsule has clearance. `vrcaps.world.world` contains the mechanics.

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
        if self.closure is not None:
            return self._closed(self.closure, T_world_capsule, (low, high))
        if least >= self.model.device.radius:
            return None
        vertices, moved = self.shown.vertices_world.copy(), np.empty(0, int)
        return self._yielding((vertices, moved), T_world_capsule, (low, high), least)

    def closed(
        self,
        closure: LumenClosure,
        T_world_capsule: Float[np.ndarray, "4 4"],
        vertices_world: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, "n 3"]:
        """Vertices of a moving wall after a slack lumen has closed [m].

        Args:
            closure: Closure of the slack lumen.
            T_world_capsule: Pose of the capsule.
            vertices_world: Vertices of the wall that the mechanics have moved [m].
        """
        half = float(self.model.axis_coordinates[-1])
        return self._closed(closure, T_world_capsule, (-half, half), vertices_world)

    def _closed(
        self,
        closure: LumenClosure,
        T_world_capsule: Float[np.ndarray, "4 4"],
        ends: tuple[float, float],
        vertices_world: Float[np.ndarray, "n 3"] | None = None,
    ) -> Float[np.ndarray, "n 3"]:
        """Vertices after the closure, off the shell and without intersecting folds [m].

        Args:
            closure: Closure of the slack lumen.
            T_world_capsule: Pose of the capsule.
            ends: Part of the body's axis in the lumen [m].
            vertices_world: Vertices of the wall before it closes [m]; None is the wall at rest.
        """
        half, radius = self.model.device.length / 2.0, self.model.device.radius
        moved, closed = closure.close(T_world_capsule, half, radius, vertices_world)
        at_rest = self.shown.vertices_world
        vertices = (at_rest if vertices_world is None else vertices_world).copy()
        vertices[moved] = closed
        self._clear_other_loops(vertices, moved, T_world_capsule)
        vertices = self._yielding((vertices, moved), T_world_capsule, ends, None)
        for _ in range(_MAX_RELAXATIONS):
            patches = closure.patches_near(vertices, T_world_capsule, half)
            if not patches:
                break
            relax(vertices, patches)
            vertices = self._yielding((vertices, moved), T_world_capsule, ends, None)
        return vertices

    @cached_property
    def closure(self) -> LumenClosure | None:
        """Closure of a slack lumen; None if it stays open."""
        return closure_of(self.shown)

    @cached_property
    def _at_rest(self) -> PointBlocks:
        """Vertices at rest [m]."""
        return PointBlocks.of(self.shown.vertices_world)

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
        box = T_world_capsule[:3, 3], max(high, -low) + 2.0 * radius
        is_candidate = np.zeros(len(vertices), bool)
        is_candidate[self._at_rest.near(*box)] = True
        is_candidate[displaced] = True
        near = np.flatnonzero(is_candidate)
        near = near[is_in_box(vertices[near], *box)]
        _stretch((vertices, near), T_world_capsule, ends, radius, least)
        return vertices

    def _clear_other_loops(
        self,
        vertices: Float[np.ndarray, "n 3"],
        closed: Int[np.ndarray, " k"],
        T_world_capsule: Float[np.ndarray, "4 4"],
    ) -> None:
        """Move other loops of the gut off a lumen that has closed around an eccentric capsule.

        The closed wall there may reach beyond the wall at rest, into a loop next to it. The other
        loops are stretched away from the capsule, as from a shell that encloses the closed wall.

        Args:
            vertices: Vertices [m], changed in place.
            closed: Which of them belong to the closed lumen.
            T_world_capsule: Pose of the capsule.
        """
        radius, half = self.model.device.radius, self.model.device.length / 2.0
        box = T_world_capsule[:3, 3], half + 3.0 * radius
        is_other = np.ones(len(vertices), bool)
        is_other[closed] = False
        near = self._at_rest.near(*box)
        other = near[is_other[near]]
        if not len(other):
            return
        offset = _from_segment(vertices[closed], T_world_capsule, (-half, half))
        offset = offset[np.abs(offset[:, 2]) < radius]
        distance = np.linalg.norm(offset, axis=1)
        around = float(distance[distance < 2.0 * radius].max(initial=radius))
        _stretch((vertices, other), T_world_capsule, (-half, half), around, None)

    def _axis(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> tuple[float, float, float]:
        """Part of the body's axis in the lumen, and its minimum distance to the wall [m].

        An end of the axis may be outside in a bend too sharp for the body. Where a bend touches the
        axis between points inside, the wall yields as well.
        """
        along = self.model.axis_coordinates
        free = self.model.axis_clearance(T_world_capsule[None])[0]
        inside = np.flatnonzero(free > 0.0)
        first, last = (inside[0], inside[-1]) if len(inside) else (0, len(along) - 1)
        least = max(float(free[first : last + 1].min()), 0.0)
        return float(along[first]), float(along[last]), least


def _stretch(
    part: tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " k"]],
    T_world_capsule: Float[np.ndarray, "4 4"],
    ends: tuple[float, float],
    radius: float,
    least: float | None,
) -> None:
    """Stretch space within two radii of a segment of the body's axis away from it.

    Args:
        part: Vertices [m], changed in place, and which of them to move.
        T_world_capsule: Pose of the capsule.
        ends: Ends of the segment [m].
        radius: Distance from it that is cleared [m].
        least: Minimum distance of the vertices to it [m]; None if unknown.
    """
    (vertices, near), reach = part, 2.0 * radius
    offset = _from_segment(vertices[near], T_world_capsule, ends)
    distance = np.linalg.norm(offset, axis=1)
    moved = (distance < reach) & (distance > _MIN_DISTANCE)
    near, distance = near[moved], distance[moved]
    if least is None:
        least = float(distance.min(initial=reach))
    if least >= radius:
        return
    fraction = np.clip((distance - least) / (reach - least), 0.0, 1.0)
    further = radius + radius * fraction ** ((reach - least) / radius) - distance
    outward = offset[moved] @ T_world_capsule[:3, :3].T / distance[:, None]
    vertices[near] += further[:, None] * outward


def _from_segment(
    points: Float[np.ndarray, "n 3"],
    T_world_capsule: Float[np.ndarray, "4 4"],
    ends: tuple[float, float],
) -> Float[np.ndarray, "n 3"]:
    """Offset of points from the nearest point of a segment of the body's axis, in its frame [m].

    Args:
        points: Points in the world frame [m].
        T_world_capsule: Pose of the capsule.
        ends: Ends of the segment [m].
    """
    offset = transform_points(invert(T_world_capsule), points)
    offset[:, 2] -= np.clip(offset[:, 2], *ends)
    return offset


_OPENING = 0.1
"""Insufflation, above the radius at rest of 1, by which gas opens a slack lumen: an estimate."""


class ShownWall:
    """Wall of a simulation as images show it: of a clean twin, and closed where it is slack."""

    def __init__(self, model: Model, shown: OrganSurface | None = None) -> None:
        """Compare the wall that is simulated with the one that is shown.

        Args:
            model: Model that is simulated.
            shown: Another organ with the same triangles, whose wall moves like the model's.

        Raises:
            InputError: If the triangles differ.
        """
        self.model = model
        self._offset = None if shown is None else _offset(model.organ, shown)
        displaced = model if shown is None else replace(model, organ=shown)
        self._displacement = WallDisplacement(model, displaced)

    def vertices_world(
        self, state: State, T_world_patient: Float[np.ndarray, "4 4"], insufflation: float
    ) -> Float[np.ndarray, "n 3"] | None:
        """Vertices of the wall [m]; None for a wall at rest.

        Args:
            state: Simulated state.
            T_world_patient: Pose of the patient.
            insufflation: Factor on the lumen's radius; gas opens a slack lumen.
        """
        vertices = state.vertices_world
        if vertices is None:
            return None
        if self._offset is not None:
            vertices = vertices + rotate_vectors(T_world_patient, self._offset)
        closure = self._displacement.closure
        if closure is None:
            return vertices
        to_model = self.model.T_world_patient @ invert(T_world_patient)
        at_model = transform_points(to_model, vertices)
        closed = self._displacement.closed(closure, to_model @ state.T_world_capsule, at_model)
        openness = smoothstep(np.array((insufflation - 1.0) / _OPENING))
        return transform_points(invert(to_model), closed + openness * (at_model - closed))


def _offset(organ: OrganSurface, shown: OrganSurface) -> Float[np.ndarray, "n 3"]:
    """Displacement from each vertex of an organ to that of one with the same triangles [m].

    Raises:
        InputError: If the triangles differ.
    """
    if not np.array_equal(organ.faces, shown.faces):
        raise InputError(
            f"{organ.name} and its clean twin have different triangles, so the one's moving wall "
            "cannot be transferred to the other. Record the twin with another motion."
        )
    return shown.vertices - organ.vertices
