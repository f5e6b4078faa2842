"""An organ from a repaired wall mesh and its centerline."""

from __future__ import annotations

import numpy as np

from vrcaps.mesh.mesh import Mesh, vertex_normals
from vrcaps.organ.surface import Centerline, OrganSurface


def organ_from_mesh(
    mesh: Mesh, centerline: Centerline, *, name: str, label_names: tuple[str, ...]
) -> OrganSurface:
    """Organ of a wall mesh: normals, gut coordinates and texture coordinates are computed.

    Args:
        mesh: The wall, faces counter-clockwise seen from the lumen, with a label for each
            vertex; its own texture coordinates stay where it has any.
        centerline: In the same frame.
        name: Name of the organ.
        label_names: Of the labels; 0 is `background`.
    """
    from vrcaps.organ.gut_coordinates import gut_coordinates
    from vrcaps.organ.uv import texture_coordinates

    assert mesh.label is not None
    arc_length, theta, radius = gut_coordinates(mesh.vertices, mesh.faces, centerline)
    uv = mesh.uv if mesh.uv is not None else texture_coordinates(mesh, arc_length, theta, radius)
    return OrganSurface(
        name=name,
        vertices=mesh.vertices,
        faces=mesh.faces,
        normals=vertex_normals(mesh.vertices, mesh.faces),
        uv=uv,
        label=mesh.label,
        label_names=label_names,
        instance=np.zeros(len(mesh.vertices), np.uint16),
        arc_length=arc_length,
        theta=theta,
        radius=radius,
        centerline=centerline,
    )
