"""Triangle improvement on a surface with two tube coordinates: collapse and flip edges.

All steps work on whole arrays: candidates that do not touch each other are done at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_NUM_ROUNDS = 25


def triangle_quality(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " m"]:
    """Shape of each triangle, 4√3 area over the sum of squared edges: 1 if equilateral."""
    corners = vertices[faces]
    edges = corners - np.roll(corners, 1, axis=1)
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return 4.0 * np.sqrt(3.0) * area / np.maximum(np.sum(edges**2, axis=(1, 2)), 1e-30)


def chart_area(
    chart: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " m"]:
    """Area of each face in the chart (along [m], θ [rad]), positive if it is not turned over."""
    one, two = (chart[faces[:, k]] - chart[faces[:, 0]] for k in (1, 2))
    for offset in (one, two):
        offset[:, 1] = np.mod(offset[:, 1] + np.pi, 2.0 * np.pi) - np.pi
    return 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


def directed_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "k 2"]:
    """The three edges of each face in its own direction; on a closed surface, each edge twice."""
    return faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)


def unique_edges(faces: Int[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Edges of a closed surface (lower vertex first) and the two faces beside each."""
    halves = directed_edges(faces)
    lower, upper = np.minimum(*halves.T), np.maximum(*halves.T)
    order = np.argsort(lower * (faces.max() + 1) + upper, kind="stable")
    edges = np.stack([lower[order[::2]], upper[order[::2]]], axis=1)
    return edges, np.stack([order[::2], order[1::2]], axis=1) // 3


def collapse_short_edges(
    vertices: Float[np.ndarray, "n 3"],
    chart: Float[np.ndarray, "n 2"],
    faces: Int[np.ndarray, "m 3"],
    pinned: Int[np.ndarray, " n"],
    shortest: float,
) -> Int[np.ndarray, "k 3"]:
    """Faces after the vertices at one end of too short edges are merged into the other end.

    Args:
        vertices: Positions [m]; they stay as they are, some become unused.
        chart: Tube coordinates (along [m], θ [rad]), in which no face may turn over.
        faces: Vertex numbers of each triangle of a closed surface.
        pinned: 0 for a free vertex, 1 for one that may only merge along edges between such,
            2 for one that stays.
        shortest: Edges under this length are collapsed [m].
    """
    rng = np.random.default_rng(0)
    for _ in range(_NUM_ROUNDS):
        edges = directed_edges(faces)
        edges = edges[edges[:, 0] < edges[:, 1]]
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        edges, length = edges[length < shortest], length[length < shortest]
        # Short edges first, but not always the same, lest one that cannot go blocks the rest.
        edges = edges[np.argsort(length * rng.uniform(0.5, 1.0, len(length)), kind="stable")]
        swap = pinned[edges[:, 0]] > pinned[edges[:, 1]]
        edges[swap] = edges[swap][:, ::-1]
        lower, upper = pinned[edges[:, 0]], pinned[edges[:, 1]]
        edges = edges[(lower == 0) | ((lower == 1) & (upper >= 1))]
        merged = _independent_merges(vertices, chart, faces, edges, pinned == 2)
        if not len(edges):
            break
        target = np.arange(len(vertices))
        target[merged[:, 0]] = merged[:, 1]
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return faces


def _independent_merges(
    vertices: np.ndarray,
    chart: np.ndarray,
    faces: np.ndarray,
    edges: np.ndarray,
    is_fixed: np.ndarray,
) -> Int[np.ndarray, "k 2"]:
    """Merges (from, into) that leave a sound surface and share no face with one another."""
    rank = np.full(len(vertices), len(edges))
    np.minimum.at(rank, edges.ravel(), np.repeat(np.arange(len(edges)), 2))
    # A merge goes first if its rank is the least in the two rings around both its ends; a
    # pole, which stays, does not make the many merges around it wait for each other.
    for _ in range(2):
        rank[is_fixed] = len(edges)
        face_rank = np.minimum.reduce([rank[faces[:, k]] for k in range(3)])
        np.minimum.at(rank, faces.ravel(), np.repeat(face_rank, 3))
    number = np.arange(len(edges))
    is_first = (rank[edges] == number[:, None]) | is_fixed[edges]
    edges = edges[is_first.all(axis=1)]
    target = np.arange(len(vertices))
    target[edges[:, 0]] = edges[:, 1]
    moved = target[faces]
    is_kept = (moved != np.roll(moved, 1, axis=1)).all(axis=1)
    is_moved = is_kept & (moved != faces).any(axis=1)
    old, new = (area_normals(vertices, f[is_moved]) for f in (faces, moved))
    cosine = np.sum(old * new, axis=1) / (
        np.linalg.norm(old, axis=1) * np.linalg.norm(new, axis=1) + 1e-30
    )
    is_bad = (cosine < 0.5) | (triangle_quality(vertices, moved[is_moved]) < 0.2)
    is_bad |= (chart_area(chart, moved[is_moved]) <= 0.0) & ~is_fixed[moved[is_moved]].any(axis=1)
    source = faces[is_moved][moved[is_moved] != faces[is_moved]]
    rejected = np.zeros(len(vertices), bool)
    rejected[source[is_bad]] = True
    rejected |= _breaks_link(faces, target)
    return edges[~rejected[edges[:, 0]]]


def _breaks_link(faces: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Vertices whose merge would fold the surface: the two ends share a third neighbour."""
    halves = directed_edges(faces)
    is_source = target[halves[:, 0]] != halves[:, 0]
    source, neighbour = halves[is_source].T
    known = np.sort(halves[:, 0] * len(target) + halves[:, 1])
    key = target[source] * len(target) + neighbour
    is_shared = known[np.minimum(np.searchsorted(known, key), len(known) - 1)] == key
    return np.bincount(source[is_shared], minlength=len(target)) > 2


def flip_edges(
    vertices: Float[np.ndarray, "n 3"],
    chart: Float[np.ndarray, "n 2"],
    faces: Int[np.ndarray, "m 3"],
    pinned: Int[np.ndarray, " n"],
    num_rounds: int = 3,
) -> Int[np.ndarray, "m 3"]:
    """Faces after edges are flipped that are not Delaunay, on nearly flat pairs only.

    Edges between two seam vertices and the faces at the poles stay, and no face turns over in
    the chart.
    """
    faces = faces.copy()
    for _ in range(num_rounds):
        edges, beside = unique_edges(faces)
        pairs = faces[beside]
        is_on = (pairs[..., None] == edges[:, None, None, :]).any(axis=-1)
        apex = pairs[~is_on].reshape(-1, 2)
        a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
        is_seam = pinned > 0
        one, other = (_cotangent(a, vertices[apex[:, k]], b) for k in range(2))
        excess = -(one + other)
        # The two opposite angles add up to more than π where their cotangents' sum is negative.
        want = (excess > 1e-3) & ~(is_seam[edges].all(axis=1))
        # Seam vertices on both sides would give an edge along or across the seam.
        want &= ~is_seam[apex].all(axis=1)
        want &= (pinned[pairs] < 2).all(axis=(1, 2))
        normals = area_normals(vertices, faces)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        want &= np.sum(normals[beside[:, 0]] * normals[beside[:, 1]], axis=1) > 0.7
        want[want] = ~_is_in(np.sort(apex[want], axis=1), edges, len(vertices))
        chosen = _independent_flips(np.flatnonzero(want), excess, beside, len(faces))
        if not len(chosen):
            break
        _flip(vertices, chart, faces, (edges[chosen], beside[chosen], apex[chosen]))
    return faces


def _independent_flips(
    candidates: np.ndarray, excess: np.ndarray, beside: np.ndarray, num_faces: int
) -> Int[np.ndarray, " k"]:
    """Candidates that share no face, the worst edges first."""
    order = candidates[np.argsort(-excess[candidates], kind="stable")]
    rank = np.full(num_faces, len(order))
    np.minimum.at(rank, beside[order].ravel(), np.repeat(np.arange(len(order)), 2))
    return order[(rank[beside[order]] == np.arange(len(order))[:, None]).all(axis=1)]


def _flip(
    vertices: np.ndarray,
    chart: np.ndarray,
    faces: np.ndarray,
    flips: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Replace the two faces of each edge by those of the other diagonal, where sound."""
    edges, beside, apex = flips
    first = faces[beside[:, 0]]
    # The direction in which the first face runs along the edge.
    is_forward = (np.roll(first, -1, axis=1) == edges[:, 1:]) & (first == edges[:, :1])
    start = np.where(is_forward.any(axis=1), edges[:, 0], edges[:, 1])
    end = edges.sum(axis=1) - start
    one = np.stack([start, apex[:, 1], apex[:, 0]], axis=1)
    two = np.stack([end, apex[:, 0], apex[:, 1]], axis=1)
    before = area_normals(vertices, first)
    is_sound = np.ones(len(edges), bool)
    for new in (one, two):
        is_sound &= chart_area(chart, new) > 0.0
        is_sound &= np.sum(area_normals(vertices, new) * before, axis=1) > 0.0
    faces[beside[is_sound, 0]] = one[is_sound]
    faces[beside[is_sound, 1]] = two[is_sound]


def _is_in(pairs: np.ndarray, edges: np.ndarray, num_vertices: int) -> Bool[np.ndarray, " n"]:
    """Whether each pair is one of the edges, which are sorted."""
    known = edges[:, 0] * num_vertices + edges[:, 1]
    key = pairs[:, 0] * num_vertices + pairs[:, 1]
    return known[np.minimum(np.searchsorted(known, key), len(known) - 1)] == key


def _cotangent(a: np.ndarray, apex: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cotangent of the angle at the apex between a and b."""
    u, v = a - apex, b - apex
    dot = np.einsum("ij,ij->i", u, v)
    square = np.einsum("ij,ij->i", u, u) * np.einsum("ij,ij->i", v, v) - dot * dot
    return dot / np.sqrt(np.maximum(square, 1e-30))


def area_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normal of each face, as long as twice its area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
