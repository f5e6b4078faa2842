"""Conversion of a swept surface to the surface of an organ, with gut coordinates."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.tube_mesh.swept_surface import make_meridian, turn_fractions
from vrcaps.anatomy.tube_mesh.tube_mesher import mesh_swept_surface
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.organ.centerline import centerline_from_points
from vrcaps.organ.surface import Centerline, OrganSurface, interpolate
from vrcaps.organ.uv_charts import TubeChart, chart_coordinates

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from jaxtyping import Float, Int, UInt8

    from vrcaps.anatomy.tube_mesh.swept_surface import SweptSurface
    from vrcaps.anatomy.tube_mesh.tube import Tube


def arc_length_of_sections(
    sections: Float[np.ndarray, " n"], tube: Tube, centerline: Centerline
) -> Float[np.ndarray, " n"]:
    """Arc length [m] at which a centerline passes the sections of a tube.

    The centerline may start next to the tube's course and join it; sections before its start map
    to its start. The result is continuous and monotonic in the section.

    Args:
        sections: Arc lengths on the tube's course [m].
        tube: The course.
        centerline: In the same frame; follows the course in the same direction.
    """
    _, nearest = scipy.spatial.KDTree(tube.curve(tube.arc_length)).query(centerline.points)
    passed = np.maximum.accumulate(tube.arc_length[nearest])
    passed, first = np.unique(passed, return_index=True)
    return np.interp(sections, passed, centerline.arc_length[first])


def angle_and_radius(
    points: Float[np.ndarray, "n 3"],
    arc_length: Float[np.ndarray, " n"],
    centerline: Centerline,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Angle [rad] around a centerline and distance [m] from it, of points at arc lengths [m].

    Args:
        points: Positions [m].
        arc_length: Arc length of each point on the centerline [m].
        centerline: In the same frame.
    """
    at, frames, _ = interpolate(centerline, arc_length)
    offset = points - at
    x, y = (np.einsum("ij,ij->i", offset, frames[:, :, k]) for k in range(2))
    theta = np.arctan2(y, x)
    return np.where(theta <= -np.pi, np.pi, theta), np.linalg.norm(offset, axis=1)


def tube_centerline(tube: Tube, vertices: Float[np.ndarray, "n 3"]) -> Centerline:
    """Course of a tube as a centerline, with the clearance to the nearest vertex of its wall."""
    points = tube.curve(tube.arc_length)
    clearance, _ = scipy.spatial.KDTree(vertices).query(points)
    return Centerline(points, tube.arc_length, clearance, tube.frames)


CENTERLINE_STEP = 1.5 * MM
"""Sample spacing of a centerline that deviates from the course [m]."""


class SelfIntersectionError(InputError):
    """A generated wall intersects itself."""


def first_sound(draws: Iterable[Callable[[], OrganSurface]], problem: str) -> OrganSurface:
    """First organ without self-intersections.

    Args:
        draws: Functions that draw an organ, and raise `SelfIntersectionError` if it has any.
        problem: Description of the patient, and the remedy, for the message.

    Raises:
        InputError: If there is none.
    """
    for draw in draws:
        with suppress(SelfIntersectionError):
            return draw()
    raise InputError(f"Found no {problem}.")


def require_sound(
    name: str, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> None:
    """Check that a wall does not intersect itself.

    Args:
        name: Name of the organ.
        vertices: Positions [m].
        faces: Vertex indices.

    Raises:
        SelfIntersectionError: If it does.
    """
    if num := len(self_intersections(vertices, faces)):
        raise SelfIntersectionError(
            f"The wall of {name} intersects itself at {num} pairs of triangles. "
            "Allowed: none. Reduce its diameter, its folds, or the bends of its course."
        )


@dataclass(frozen=True)
class TubeMesh:
    """Triangle mesh of a swept surface with its surface coordinates.

    Attributes:
        vertices: Positions [m].
        faces: Vertex indices, counter-clockwise as seen from inside.
        arc_length: Arc length of each vertex's section on the course [m].
        theta: Angle of each vertex [rad].
        radius: Distance of each vertex from the course [m].
        turn: Fraction of the circumference from the seam at each corner, 0 to 1.
        along: Meridian length at each corner [m].
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    arc_length: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    radius: Float[np.ndarray, " n"]
    turn: Float[np.ndarray, "m 3"]
    along: Float[np.ndarray, "m 3"]


def mesh_tube(surface: SweptSurface) -> TubeMesh:
    """Mesh a swept surface with triangles."""
    grid = mesh_swept_surface(surface)
    s = make_meridian(surface).to_arc_length(grid.along)
    radius = surface.radius(s, grid.theta)
    vertices = surface.tube.points(s, grid.theta, radius)
    along = grid.along[grid.faces]
    return TubeMesh(vertices, grid.faces, s, grid.theta, radius, turn_fractions(grid), along)


def surface_to_organ(
    surface: SweptSurface,
    name: str,
    *,
    segments: tuple[str, ...],
    label: Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], UInt8[np.ndarray, " n"]],
    metadata: dict,
    path: Float[np.ndarray, "k 3"] | None = None,
) -> OrganSurface:
    """Convert a swept surface to a closed mesh with labels, gut coordinates and centerline.

    Args:
        surface: The wall.
        name: Name of the organ.
        segments: Names of the labels from 1 upwards.
        label: Segment label, from 1, at arc lengths [m] and angles [rad] on the surface.
        metadata: Provenance of the organ.
        path: Points that the centerline follows [m]; None is the tube's course.

    Raises:
        SelfIntersectionError: If the wall intersects itself.
    """
    mesh = mesh_tube(surface)
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int32)
    require_sound(name, vertices, faces)
    if path is None:
        centerline = tube_centerline(surface.tube, vertices)
        arc_length, theta, radius = mesh.arc_length, mesh.theta, mesh.radius
    else:
        centerline = centerline_from_points(path, vertices, faces, step=CENTERLINE_STEP)
        arc_length = arc_length_of_sections(mesh.arc_length, surface.tube, centerline)
        theta, radius = angle_and_radius(vertices, arc_length, centerline)
    return OrganSurface(
        name=name,
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=chart_coordinates(TubeChart(faces, vertices[faces], mesh.turn, mesh.along)),
        label=label(mesh.arc_length, mesh.theta),
        label_names=("background", *segments),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=arc_length,
        theta=theta,
        radius=radius,
        centerline=centerline,
        metadata=metadata,
    )
