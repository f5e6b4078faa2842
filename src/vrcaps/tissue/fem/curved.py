"""Triangles with bent edges, and their relaxation where the layer over them would fold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tissue.fem.elements import EDGES, shapes
from vrcaps.tissue.fem.layer import CoarseSurface, thinnest

if TYPE_CHECKING:
    from jaxtyping import Float, Int

# The midpoint of an edge bulges by at most this fraction of its length, as on an arc of 80 degrees.
_LARGEST_BULGE = 0.18
_ROUNDS = 60
# Number of rounds that move the corners of bad triangles only; then one more ring is added, etc.
_ROUNDS_BY_RING = 15
# An element is bad if its volume shrinks anywhere to this fraction of its mean.
_THIN = 0.1
_RELAXATION = 0.25


@dataclass(frozen=True)
class BentTriangles:
    """Triangles whose edge midpoints may lie off the straight edges.

    Attributes:
        corners: Positions [m].
        pairs: Corners of each edge.
        bulges: Offset from the midpoint of the straight edge to that of the bent edge [m].
        triangles: Corners of each triangle, then the indices of its edges 01, 12, 02.
    """

    corners: Float[np.ndarray, "c 3"]
    pairs: Int[np.ndarray, "e 2"]
    bulges: Float[np.ndarray, "e 3"]
    triangles: Int[np.ndarray, "m 6"]

    @property
    def surface(self) -> CoarseSurface:
        """The triangles with nodes at the edge midpoints and outward directions."""
        nodes = np.concatenate([self.corners, _middles(self.corners, self.pairs) + self.bulges])
        number = self.triangles + len(self.corners) * (np.arange(6) >= 3)
        return CoarseSurface(nodes, _outward(nodes, number), number)


def edges_of(triangles: Int[np.ndarray, "m 3"]) -> tuple[np.ndarray, Int[np.ndarray, "m 6"]]:
    """Corners of all edges, and the triangles with the indices of their edges 01, 12, 02."""
    sides = np.stack([np.sort(triangles[:, list(pair)], axis=1) for pair in EDGES[:3]], axis=1)
    pairs, side = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    return pairs, np.concatenate([triangles, side.reshape(-1, 3)], axis=1)


def bulges_towards(
    corners: Float[np.ndarray, "c 3"],
    pairs: Int[np.ndarray, "e 2"],
    middle: Float[np.ndarray, "e 3"],
) -> Float[np.ndarray, "e 3"]:
    """Bulges perpendicular to the edges that move their midpoints towards given points."""
    chord = corners[pairs[:, 1]] - corners[pairs[:, 0]]
    length = np.linalg.norm(chord, axis=1, keepdims=True)
    bulge = middle - _middles(corners, pairs)
    bulge -= (bulge * chord).sum(1, keepdims=True) / length**2 * chord
    size = np.linalg.norm(bulge, axis=1, keepdims=True)
    return bulge * np.minimum(1.0, _LARGEST_BULGE * length / np.maximum(size, 1e-12))


def relaxed(bent: BentTriangles, thickness: float) -> BentTriangles:
    """Straighten and even out triangles whose layer would fold, as far as possible."""
    first, last = bent.pairs.T
    degree = np.bincount(bent.pairs.ravel(), minlength=len(bent.corners))
    for number in range(_ROUNDS):
        bad = thinnest(bent.surface, thickness) < _THIN
        if not bad.any():
            break
        for _ in range(number // _ROUNDS_BY_RING):
            bad = np.isin(bent.triangles[:, :3], bent.triangles[bad, :3]).any(axis=1)
        total = np.zeros_like(bent.corners)
        np.add.at(total, first, bent.corners[last])
        np.add.at(total, last, bent.corners[first])
        corners, bulges = bent.corners.copy(), bent.bulges.copy()
        move = np.unique(bent.triangles[bad, :3])
        corners[move] += _RELAXATION * (total[move] / degree[move, None] - corners[move])
        bulges[np.unique(bent.triangles[bad, 3:])] *= 1.0 - _RELAXATION
        bent = replace(bent, corners=corners, bulges=bulges)
    return bent


def _middles(
    corners: Float[np.ndarray, "c 3"], pairs: Int[np.ndarray, "e 2"]
) -> Float[np.ndarray, "e 3"]:
    return corners[pairs].mean(axis=1)


def _outward(
    nodes: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 6"]
) -> Float[np.ndarray, "n 3"]:
    """Unit directions away from the lumen: area-weighted means over the adjacent triangles."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    places = np.concatenate([corners, [(corners[a] + corners[b]) / 2.0 for a, b in EDGES[:3]]])
    tangents = np.einsum("eai,qaj->eqji", nodes[triangles], shapes(places)[1])
    inward = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    total = np.stack(
        [np.bincount(triangles.ravel(), inward[..., k].ravel(), len(nodes)) for k in range(3)], 1
    )
    return -total / np.linalg.norm(total, axis=1, keepdims=True)
