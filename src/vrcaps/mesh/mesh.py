"""Plain triangle mesh, and the normals of its vertices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.core.geometry import triangle_normals

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8, UInt16


@dataclass(frozen=True)
class Mesh:
    """Plain triangle mesh as stored in a file, in meters.

    Attributes:
        vertices: Positions [m].
        faces: Vertex indices of each triangle.
        uv: Texture coordinates of each corner of each face, or None.
        label: Class of each vertex, or None.
        instance: Lesion ID of each vertex, or None.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    uv: Float[np.ndarray, "m 3 2"] | None = None
    label: UInt8[np.ndarray, " n"] | None = None
    instance: UInt16[np.ndarray, " n"] | None = None


def vertex_normals(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """Unit vertex normals: the area-weighted mean of the normals of adjacent faces."""
    area_normals = triangle_normals(vertices[faces])
    normals = np.zeros_like(vertices)
    for axis in range(3):
        normals[:, axis] = sum(
            np.bincount(faces[:, corner], area_normals[:, axis], len(vertices))
            for corner in range(3)
        )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0.0, length, 1.0)


def wall_of(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Wall:
    """Wall of a surface, for queries in the frame of its vertices [m]."""
    return Wall(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int64))
