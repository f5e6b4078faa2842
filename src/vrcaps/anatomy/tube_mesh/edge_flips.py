"""Edge flips that make a surface with tube coordinates Delaunay.

The flips are vectorized: candidates that do not touch each other are flipped together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.tube_mesh.waves import wrap
from vrcaps.mesh.edges import area_vectors, find_edges
from vrcaps.mesh.mesh import Mesh

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


def chart_area(
    chart: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " m"]:
    """Area of each face in the chart (along [m], θ [rad]), negative if it is flipped over."""
    one, two = (chart[faces[:, k]] - chart[faces[:, 0]] for k in (1, 2))
    for offset in (one, two):
        offset[:, 1] = wrap(offset[:, 1])
    return 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


def flip_edges(
    vertices: Float[np.ndarray, "n 3"],
    chart: Float[np.ndarray, "n 2"],
    faces: Int[np.ndarray, "m 3"],
    pinned: Int[np.ndarray, " n"],
    num_rounds: int = 3,
) -> Int[np.ndarray, "m 3"]:
    """Flip edges that are not Delaunay, on nearly flat pairs of faces only.

    Edges between two seam vertices and faces at the poles are kept, and no face flips over in
    the chart.

    Args:
        vertices: Positions [m].
        chart: Meridian length [m] and angle [rad] of each vertex.
        faces: Vertex indices.
        pinned: `FREE`, `SEAM` or `POLE` of each vertex.
        num_rounds: Maximum number of rounds of flips.
    """
    faces = faces.copy()
    for _ in range(num_rounds):
        halves = find_edges(faces)
        pair = halves.with_count(2)
        edges, beside = np.sort(halves.ends[pair[:, 0]], axis=1), pair // 3
        apex = faces.ravel()[3 * beside + (pair + 2) % 3]
        a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
        is_seam, is_pole = pinned > 0, pinned > 1
        one, other = (_cotangent(a, vertices[apex[:, k]], b) for k in range(2))
        excess = -(one + other)
        # The two opposite angles add up to more than π if the sum of their cotangents is negative.
        want = (excess > 1e-3) & ~(is_seam[edges[:, 0]] & is_seam[edges[:, 1]])
        # Seam vertices on both sides would give an edge along or across the seam.
        want &= ~(is_seam[apex[:, 0]] & is_seam[apex[:, 1]])
        for end in (*edges.T, *apex.T):
            want &= ~is_pole[end]
        normals = area_vectors(Mesh(vertices, faces))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        one, other = normals[beside[want].T]
        want[want] = np.sum(one * other, axis=1) > 0.7
        want[want] = ~_is_in(np.sort(apex[want], axis=1), edges, len(vertices))
        chosen = _independent_flips(np.flatnonzero(want), excess, beside, len(faces))
        chosen = _distinct_flips(chosen, apex)
        if not len(chosen):
            break
        _flip(vertices, chart, faces, (edges[chosen], beside[chosen], apex[chosen]))
    return faces


def _independent_flips(
    candidates: np.ndarray, excess: np.ndarray, beside: np.ndarray, num_faces: int
) -> Int[np.ndarray, " k"]:
    """Candidates that share no face, worst edges first."""
    order = candidates[np.argsort(-excess[candidates], kind="stable")]
    rank = np.full(num_faces, len(order))
    np.minimum.at(rank, beside[order].ravel(), np.repeat(np.arange(len(order)), 2))
    return order[(rank[beside[order]] == np.arange(len(order))[:, None]).all(axis=1)]


def _distinct_flips(chosen: Int[np.ndarray, " k"], apex: np.ndarray) -> Int[np.ndarray, " l"]:
    """Flips without pairs that create the same edge, which would then have four faces."""
    _, first = np.unique(np.sort(apex[chosen], axis=1), axis=0, return_index=True)
    return chosen[np.sort(first)]


def _flip(
    vertices: np.ndarray,
    chart: np.ndarray,
    faces: np.ndarray,
    flips: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Replace the two faces of each edge by those of the other diagonal, where valid."""
    edges, beside, apex = flips
    first = faces[beside[:, 0]]
    # Direction in which the first face traverses the edge.
    is_forward = (np.roll(first, -1, axis=1) == edges[:, 1:]) & (first == edges[:, :1])
    start = np.where(is_forward.any(axis=1), edges[:, 0], edges[:, 1])
    end = edges.sum(axis=1) - start
    one = np.stack([start, apex[:, 1], apex[:, 0]], axis=1)
    two = np.stack([end, apex[:, 0], apex[:, 1]], axis=1)
    before = area_vectors(Mesh(vertices, first))
    is_sound = np.ones(len(edges), bool)
    for new in (one, two):
        is_sound &= chart_area(chart, new) > 0.0
        is_sound &= np.sum(area_vectors(Mesh(vertices, new)) * before, axis=1) > 0.0
    faces[beside[is_sound, 0]] = one[is_sound]
    faces[beside[is_sound, 1]] = two[is_sound]


def _is_in(pairs: np.ndarray, edges: np.ndarray, num_vertices: int) -> Bool[np.ndarray, " n"]:
    """Check which pairs are among the sorted edges."""
    known = edges[:, 0] * num_vertices + edges[:, 1]
    key = pairs[:, 0] * num_vertices + pairs[:, 1]
    return known[np.minimum(np.searchsorted(known, key), len(known) - 1)] == key


def _cotangent(a: np.ndarray, apex: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cotangent of the angle at the apex between a and b."""
    u, v = a - apex, b - apex
    dot = np.einsum("ij,ij->i", u, v)
    square = np.einsum("ij,ij->i", u, u) * np.einsum("ij,ij->i", v, v) - dot * dot
    return dot / np.sqrt(np.maximum(square, 1e-30))
