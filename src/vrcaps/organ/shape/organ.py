"""From a skin to the finished surface of an organ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.organ.shape.coordinates import tube_centerline
from vrcaps.organ.shape.rows import mesh_skin
from vrcaps.organ.shape.skin import make_meridian, turns
from vrcaps.organ.surface import OrganSurface, vertex_normals
from vrcaps.organ.texture_charts import TubeChart, chart_coordinates

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float, UInt8

    from vrcaps.organ.shape.skin import Skin


def skin_to_organ(
    skin: Skin,
    name: str,
    *,
    segments: tuple[str, ...],
    label: Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], UInt8[np.ndarray, " n"]],
    metadata: dict,
) -> OrganSurface:
    """A skin as a closed triangle surface whose centreline is the tube's course.

    Args:
        skin: The wall.
        name: Of the organ.
        segments: Names of the labels from 1 on.
        label: Segment number, from 1, of arc lengths [m] and angles [rad].
        metadata: Where the organ comes from.
    """
    grid = mesh_skin(skin)
    s = make_meridian(skin).to_arc_length(grid.along)
    radius = skin.radius(s, grid.theta)
    vertices = skin.tube.points(s, grid.theta, radius)
    faces = grid.faces.astype(np.int32)
    return OrganSurface(
        name=name,
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=chart_coordinates(TubeChart(faces, vertices[faces], turns(grid), grid.along[faces])),
        label=label(s, grid.theta),
        label_names=("background", *segments),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=s,
        theta=grid.theta,
        radius=radius,
        centerline=tube_centerline(skin.tube, vertices),
        metadata=metadata,
    )
