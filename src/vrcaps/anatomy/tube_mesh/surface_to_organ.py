"""Conversion of a swept surface to the surface of an organ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.tube_mesh.coordinates import (
    angle_and_radius,
    arc_length_of_sections,
    tube_centerline,
)
from vrcaps.anatomy.tube_mesh.swept_surface import make_meridian, turn_fractions
from vrcaps.anatomy.tube_mesh.tube_mesher import mesh_swept_surface
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.centerline import centerline_from_points
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.uv_charts import TubeChart, chart_coordinates

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float, Int, UInt8

    from vrcaps.anatomy.tube_mesh.swept_surface import SweptSurface

CENTERLINE_STEP = 1.5 * MM
"""Sample spacing of a centerline that deviates from the course [m]."""


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
    """
    mesh = mesh_tube(surface)
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int32)
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
