"""Where a triangle surface cuts through itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import KDTree

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


def self_intersections(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, "k 2"]:
    """Pairs of triangles that cut each other.

    Two triangles cut where an edge of one passes through the other (Möller & Trumbore 1997).
    Edges that share a vertex with the other triangle touch it there and do not count; so
    neighbours across an edge are never reported, neighbours at a vertex are.
    """
    corners = vertices[faces]
    center = corners.mean(axis=1)
    reach = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
    pairs = _near_pairs(center, reach)
    low, high = corners.min(axis=1), corners.max(axis=1)
    found = []
    for chunk in np.array_split(pairs, max(1, len(pairs) // 400_000)):
        i, j = chunk.T
        is_near = np.linalg.norm(center[i] - center[j], axis=1) < reach[i] + reach[j]
        i, j = i[is_near], j[is_near]
        is_near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
        i, j = i[is_near], j[is_near]
        is_crossing = _any_edge_through(vertices, faces[i], faces[j])
        is_crossing |= _any_edge_through(vertices, faces[j], faces[i])
        found.append(np.stack([i[is_crossing], j[is_crossing]], axis=1))
    return np.concatenate(found)


def _near_pairs(
    center: Float[np.ndarray, "n 3"], reach: Float[np.ndarray, " n"]
) -> Int[np.ndarray, "k 2"]:
    """Pairs of balls that may meet, searched size by size: a few large ones cost little."""
    size = np.round(np.log2(reach / np.median(reach)) * 1.5).astype(int)
    members = [np.flatnonzero(size == k) for k in np.unique(size)]
    trees = [KDTree(center[member]) for member in members]
    most = [reach[member].max() for member in members]
    pairs = [np.zeros((0, 2), int)]
    for i, member in enumerate(members):
        pairs.append(member[trees[i].query_pairs(2.0 * most[i], output_type="ndarray")])
        for j in range(i):
            found = trees[i].sparse_distance_matrix(
                trees[j], most[i] + most[j], output_type="ndarray"
            )
            pairs.append(np.stack([member[found["i"]], members[j][found["j"]]], axis=1))
    return np.sort(np.concatenate(pairs), axis=1)


def _any_edge_through(
    vertices: np.ndarray, one: np.ndarray, other: np.ndarray
) -> Bool[np.ndarray, " n"]:
    """Whether an edge of the first triangle passes through the second, pair by pair."""
    a, b, c = (vertices[other[:, k]] for k in range(3))
    u, v = b - a, c - a
    is_through = np.zeros(len(one), bool)
    for k in range(3):
        ends = one[:, [k, (k + 1) % 3]]
        is_apart = (ends[:, :, None] != other[:, None, :]).all(axis=(1, 2))
        start = vertices[ends[:, 0]]
        edge = vertices[ends[:, 1]] - start
        normal = np.cross(edge, v)
        scale = np.einsum("ij,ij->i", u, normal)
        # Parallel edges give NaN or infinity, which no comparison below accepts.
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = start - a
            first = np.einsum("ij,ij->i", offset, normal) / scale
            across = np.cross(offset, u)
            second = np.einsum("ij,ij->i", edge, across) / scale
            along = np.einsum("ij,ij->i", v, across) / scale
            inside = (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0)
        is_through |= is_apart & inside & (along >= 0.0) & (along <= 1.0)
    return is_through
