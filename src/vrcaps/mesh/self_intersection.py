"""Self-intersections of a triangle mesh."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.geometry import cross_products, triangle_normals
from vrcaps.mesh.mesh import used_vertices

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_FLAT = 1e-12
"""Heights over a plane below this fraction of the mesh's size are rounding errors."""
_CHUNK = 200_000
"""Maximum number of pairs per thread task."""


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
    size = float(np.linalg.norm(np.ptp(vertices[faces], axis=(0, 1))))
    corners = vertices[faces]
    normals = triangle_normals(corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    pairs = _touching_boxes(corners.min(axis=1).T, corners.max(axis=1).T)

    def cut(chunk: Int[np.ndarray, "k 2"]) -> Int[np.ndarray, "l 2"]:
        shared = _num_shared(faces, chunk)
        chunk, shared = chunk[shared < 2], shared[shared < 2]
        return chunk[_is_cut(corners, normals, chunk, shared, _FLAT * size)]

    if len(pairs) <= _CHUNK:
        pairs = cut(pairs)
    else:
        with ThreadPoolExecutor(_core.num_threads()) as threads:
            parts = list(threads.map(cut, np.array_split(pairs, len(pairs) // _CHUNK + 1)))
        pairs = np.concatenate(parts)
    return pairs[np.lexsort(pairs.T[::-1])]


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


def _touching_boxes(
    low: Float[np.ndarray, "3 n"], high: Float[np.ndarray, "3 n"]
) -> Int[np.ndarray, "k 2"]:
    """Pairs i < j of overlapping boxes: level-by-level traversal of a tree in Morton order."""
    num = low.shape[1]
    depth = max(num - 1, 1).bit_length()
    order = np.argsort(_morton(low + high), kind="stable")
    empty = np.full((3, 2**depth - num), np.inf)
    levels = [(np.hstack([low[:, order], empty]), np.hstack([high[:, order], -empty]))]
    for _ in range(depth):
        below, above = levels[-1]
        levels.append(
            (np.minimum(below[:, ::2], below[:, 1::2]), np.maximum(above[:, ::2], above[:, 1::2]))
        )
    one = other = np.zeros(1, np.int32)
    for below, above in levels[-2::-1]:
        is_same = one == other
        both, (i, j) = 2 * one[is_same], (2 * one[~is_same], 2 * other[~is_same])
        one = np.concatenate([both, both, both + 1, i, i, i + 1, i + 1])
        other = np.concatenate([both, both + 1, both + 1, j, j + 1, j, j + 1])
        for k in range(3):
            is_near = (below[k, one] <= above[k, other]) & (below[k, other] <= above[k, one])
            one, other = one[is_near], other[is_near]
    is_pair = one != other
    return np.sort(order[np.stack([one[is_pair], other[is_pair]], axis=1)], axis=1)


def _morton(points: Float[np.ndarray, "3 n"]) -> Int[np.ndarray, " n"]:
    """Morton code of points: interleaved bits of x, y and z."""
    low = points.min(axis=1, keepdims=True)
    extent = max(float(np.ptp(points, axis=1).max()), np.finfo(float).tiny)
    cell = (1023.0 * (points - low) / extent).astype(np.int64)
    bits = cell[:, None] >> np.arange(10)[:, None] & 1
    return (bits << (3 * np.arange(10)[:, None] + np.arange(3)[:, None, None])).sum(axis=(0, 1))


def _num_shared(
    faces: Int[np.ndarray, "m 3"], pairs: Int[np.ndarray, "k 2"]
) -> Int[np.ndarray, " k"]:
    """Number of vertices shared by the triangles of each pair."""
    one, other = faces.T[:, pairs.T].swapaxes(0, 1)
    same = [one[a] == other[b] for a in range(3) for b in range(3)]
    return np.count_nonzero(same, axis=0)


def _is_cut(
    corners: Float[np.ndarray, "m 3 3"],
    normals: Float[np.ndarray, "m 3"],
    pairs: Int[np.ndarray, "k 2"],
    shared: Int[np.ndarray, " k"],
    tolerance: float,
) -> Bool[np.ndarray, " k"]:
    """Return whether each pair of triangles intersects; heights within the tolerance [m] are zero.

    Triangles that share a vertex and have no other vertex on the other's plane do not intersect.
    """
    kept, sides = np.arange(len(pairs)), np.zeros((2, len(pairs), 3), np.int8)
    for k in range(2):
        one, other = pairs[kept, k], pairs[kept, 1 - k]
        sides[k, kept] = _sides(corners[one], corners[other, :1], normals[other], tolerance)
        kept = kept[np.abs(sides[k, kept].sum(axis=1)) < 3 - shared[kept]]
    one, other = corners[pairs[kept]].swapaxes(0, 1)
    is_cut = np.zeros(len(pairs), bool)
    is_cut[kept] = _any_edge_through(one, other, sides[0, kept])
    is_cut[kept] |= _any_edge_through(other, one, sides[1, kept])
    flat = ~sides[:, kept].any(axis=(0, 2))
    is_cut[kept[flat]] = _overlap(one[flat], other[flat], normals[pairs[kept[flat], 0]], tolerance)
    return is_cut


def _sides(
    corners: Float[np.ndarray, "k 3 3"],
    origin: Float[np.ndarray, "k 1 3"],
    normal: Float[np.ndarray, "k 3"],
    tolerance: float,
) -> Int[np.ndarray, "k 3"]:
    """Side of a plane for each corner: −1, 0 or 1."""
    height = np.einsum("nij,nj->ni", corners - origin, normal)
    return (height > tolerance).astype(np.int8) - (height < -tolerance)


def _any_edge_through(
    one: Float[np.ndarray, "k 3 3"],
    other: Float[np.ndarray, "k 3 3"],
    side: Int[np.ndarray, "k 3"],
) -> Bool[np.ndarray, " k"]:
    """Return whether an edge of the first triangle passes through the second, for each pair.

    An edge p q with its ends on both sides of the plane of a b c passes through if the volumes
    of p q a b, p q b c and p q c a have one sign. `side` gives the side of each corner.
    """
    is_through = np.zeros(len(one), bool)
    for k in range(3):
        split = np.flatnonzero(side[:, k] * side[:, k - 1] < 0)
        start = one[split, k]
        edge = one[split, k - 1] - start
        a, b, c = (other[split, corner] - start for corner in range(3))
        volumes = np.stack(
            [np.einsum("ij,ij->i", edge, cross_products(u, v)) for u, v in ((a, b), (b, c), (c, a))]
        )
        is_through[split] |= (volumes >= 0.0).all(axis=0) | (volumes <= 0.0).all(axis=0)
    return is_through


def _overlap(
    one: Float[np.ndarray, "k 3 3"],
    other: Float[np.ndarray, "k 3 3"],
    normal: Float[np.ndarray, "k 3"],
    tolerance: float,
) -> Bool[np.ndarray, " k"]:
    """Return whether coplanar triangles share an area, i.e. none of their edges separates them."""
    is_apart = np.zeros(len(one), bool)
    for triangle in (one, other):
        for k in range(3):
            across = cross_products(triangle[:, k] - triangle[:, k - 1], normal)
            across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), tolerance)
            first, second = (np.einsum("nij,nj->ni", t, across) for t in (one, other))
            is_apart |= first.max(axis=1) <= second.min(axis=1) + tolerance
            is_apart |= second.max(axis=1) <= first.min(axis=1) + tolerance
    return ~is_apart
