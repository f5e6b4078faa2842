"""Self-intersections of a triangle mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.mesh.mesh import used_vertices

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_FLAT = 1e-12
"""Heights over a plane below this fraction of the mesh's size are rounding errors."""


def self_intersections(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, "k 2"]:
    """Return pairs of intersecting triangles, the lower index first.

    Two triangles intersect if an edge of one runs from one side of the other to its far side
    through its inside or border, or if they overlap in one plane. Touching does not count, nor
    does meeting at vertices; vertices at the same position count as one. Neighbors across
    an edge are never reported, neighbors at a vertex are.

    Args:
        vertices: Positions [m].
        faces: Vertex indices; triangles without area are ignored.
    """
    if not len(faces):
        return np.zeros((0, 2), int)
    used, faces = used_vertices(faces, len(vertices))
    vertices = vertices[used]
    faces = _position_ids(vertices)[faces]
    corners = vertices[faces]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return _core.intersecting_triangles(corners, faces, _FLAT * size)


def cluster_intersections(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    pairs: Int[np.ndarray, "k 2"],
) -> Float[np.ndarray, "p 3"]:
    """Center of each self-intersection [m], the one with most pairs first.

    Pairs belong to one intersection if their triangles meet.

    Args:
        vertices: Positions [m].
        faces: Vertex indices.
        pairs: Result of `self_intersections`.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(pairs):
        return np.zeros((0, 3))
    joined = faces[pairs].reshape(-1, 6)
    ends = np.repeat(joined[:, :1], 5, axis=1).ravel(), joined[:, 1:].ravel()
    num = len(vertices)
    graph = coo_array((np.ones(len(ends[0])), ends), shape=(num, num))
    cluster = connected_components(graph, directed=False)[1][joined[:, 0]]
    _, cluster, count = np.unique(cluster, return_inverse=True, return_counts=True)
    # The smaller triangle of each pair locates the intersection better.
    corners = vertices[faces[pairs]]
    extent = np.ptp(corners, axis=2).max(axis=2)
    middle = corners[np.arange(len(pairs)), extent.argmin(axis=1)].mean(axis=1)
    centers = (
        np.stack([np.bincount(cluster, middle[:, k]) for k in range(3)], axis=1) / count[:, None]
    )
    return centers[np.argsort(-count, kind="stable")]


def _position_ids(vertices: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Index of the first vertex at the same position, for each vertex."""
    order = np.lexsort(vertices.T)
    is_new = np.append(True, (np.diff(vertices[order], axis=0) != 0.0).any(axis=1))
    same = np.empty(len(vertices), int)
    same[order] = order[np.flatnonzero(is_new)[np.cumsum(is_new) - 1]]
    return same
