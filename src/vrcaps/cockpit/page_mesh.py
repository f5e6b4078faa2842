"""Decimated mesh of an organ's wall that a browser can draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import triangle_areas

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_MAX_FACES = 12_000


@dataclass(frozen=True)
class PageMesh:
    """Coarse wall that uses some vertices of the fine one, so that it moves with it.

    Attributes:
        vertices: Indices of the fine wall's vertices.
        faces: Triangles of indices into `vertices`.
    """

    vertices: Int[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]


def coarse_mesh(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], most: int = _MAX_FACES
) -> PageMesh:
    """Decimate a wall to a triangle count by vertex clustering (Rossignac & Borrel, 1993).

    All vertices in a cell of a cubic grid are replaced by the one nearest to their mean; triangles
    with corners in fewer than three cells are removed. The grid is as fine as possible.

    Args:
        points: Vertices of the fine wall.
        faces: Its triangles.
        most: Maximum number of triangles.
    """
    if len(faces) <= most:
        return PageMesh(np.arange(len(points)), np.asarray(faces))
    cell = float(np.sqrt(2.0 * triangle_areas(points[faces]).sum() / most))
    while True:
        mesh = _clustered(points, faces, cell)
        if len(mesh.faces) <= most:
            return mesh
        cell *= 1.1


def _clustered(points: np.ndarray, faces: np.ndarray, cell: float) -> PageMesh:
    grid = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    _, cluster = np.unique(grid, axis=0, return_inverse=True)
    cluster = cluster.reshape(-1)
    count = np.bincount(cluster)
    mean = np.stack([np.bincount(cluster, axis) for axis in points.T], axis=1) / count[:, None]
    distance = np.linalg.norm(points - mean[cluster], axis=1)
    order = np.lexsort((distance, cluster))
    chosen = order[np.concatenate([[0], np.cumsum(count)[:-1]])]
    coarse = cluster[faces]
    a, b, c = coarse.T
    coarse = coarse[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(coarse, axis=1), axis=0, return_index=True)
    return PageMesh(chosen, coarse[np.sort(first)])
