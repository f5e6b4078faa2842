"""Ileocaecal valve: stitching of the end of one wall into an opening of another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.mesh.edges import directed_edges

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_NUM_SMOOTHINGS = 12
_NUM_RINGS = 4


def without_vertices(
    faces: Int[np.ndarray, "m 3"], is_removed: Bool[np.ndarray, " n"]
) -> tuple[Bool[np.ndarray, " m"], Int[np.ndarray, " k"]]:
    """Mask of the faces left after removing vertices, and the ordered rim of the hole.

    The rim has the orientation of its faces; of several holes, the longest rim is returned.
    """
    is_kept = np.logical_not(is_removed[faces].any(axis=1))
    halves = directed_edges(faces[is_kept])
    num = len(is_removed)
    is_single = ~np.isin(halves[:, 0] * num + halves[:, 1], halves[:, 1] * num + halves[:, 0])
    following = dict(halves[is_single].tolist())
    longest: list[int] = []
    while following:
        start, at = next(iter(following.items()))
        loop = [start]
        del following[start]
        while at != start and at in following:
            loop.append(at)
            at = following.pop(at)
        if len(loop) > len(longest):
            longest = loop
    return np.asarray(is_kept), np.array(longest)


def stitch(
    vertices: Float[np.ndarray, "n 3"],
    one: Int[np.ndarray, " k"],
    other: Int[np.ndarray, " l"],
) -> Int[np.ndarray, "m 3"]:
    """Faces of the band between two opposite rims.

    Args:
        vertices: Vertices of both walls [m].
        one: First rim, in the orientation of its faces.
        other: Second rim, in the orientation of its own faces, thus opposite to the first.
    """
    other = other[::-1]
    nearest = np.linalg.norm(vertices[other] - vertices[one[0]], axis=1).argmin()
    other = np.roll(other, -nearest)
    fractions = [_fractions(vertices, rim) for rim in (one, other)]
    mids = [0.5 * (fraction[1:] + fraction[:-1]) for fraction in fractions]
    across = [np.searchsorted(mids[1], mids[0]), np.searchsorted(mids[0], mids[1], "right")]
    first = np.stack([np.roll(one, -1), one, other[across[0] % len(other)]], axis=1)
    second = np.stack([other, np.roll(other, -1), one[across[1] % len(one)]], axis=1)
    return np.concatenate([first, second])


def soften(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    rim: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "n 3"]:
    """Smooth vertices towards the mean of their neighbors, with strength falling off from a rim.

    Args:
        vertices: Positions [m].
        faces: Vertex indices.
        rim: Vertices around which the wall is smoothed.
    """
    edges = directed_edges(faces)
    ring = np.full(len(vertices), _NUM_RINGS)
    ring[rim] = 0
    for distance in range(1, _NUM_RINGS):
        reached = edges[ring[edges[:, 0]] == distance - 1, 1]
        ring[reached] = np.minimum(ring[reached], distance)
    edges = edges[ring[edges[:, 0]] < _NUM_RINGS]
    count = np.maximum(np.bincount(edges[:, 0], minlength=len(vertices)), 1)
    weight = (0.5 * (1.0 - ring / _NUM_RINGS))[:, None]
    vertices = vertices.copy()
    for _ in range(_NUM_SMOOTHINGS):
        mean = np.stack(
            [np.bincount(edges[:, 0], vertices[edges[:, 1], k], len(vertices)) for k in range(3)],
            axis=1,
        )
        vertices += weight * (mean / count[:, None] - vertices)
    return vertices


def _fractions(vertices: np.ndarray, rim: np.ndarray) -> Float[np.ndarray, " k"]:
    """Fraction of a closed rim's length at each vertex and, last, back at the first."""
    step = np.linalg.norm(vertices[np.roll(rim, -1)] - vertices[rim], axis=1)
    return np.append(0.0, np.cumsum(step)) / step.sum()
