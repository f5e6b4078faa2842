"""Embedding of the fine surface in the coarse layer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tissue.fem.layer import shapes

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.tissue.fem.coarse import Coarsened
    from vrcaps.tissue.fem.layer import Layer

_ROUNDS = 6
_MAX_WEIGHT = 6.0


@dataclass(frozen=True)
class Embedding:
    """Fine vertices as weighted sums of nodes, exact for every field that is linear in space.

    Attributes:
        nodes: Six nodes of the inner surface, then the six above them outside.
        weights: Their weights; those of a vertex sum to 1 and reproduce its position.
    """

    nodes: Int[np.ndarray, "n 12"]
    weights: Float[np.ndarray, "n 12"]


def embed(vertices: Float[np.ndarray, "n 3"], coarsened: Coarsened, layer: Layer) -> Embedding:
    """Embed fine vertices in a layer.

    Each smoothed vertex has coordinates (ξ, η, height) in the layer, on the triangle around its
    cell in which it lies deepest. From the nearest point covered by the layer to the vertex itself,
    which may be offset by a fold, the map of the layer is linearized. Where this gives large
    weights, far from the layer at a sharp bend, the exact weights of minimum change are used.
    """
    inner = coarsened.surface.triangles
    outer = layer.outer_triangles
    triangle, position = _locate(coarsened, layer)
    position = _covered(position)
    values, slopes = shapes(position[:, :2])
    low, high = layer.nodes[inner[triangle]], layer.nodes[outer[triangle]]
    jacobian, there = _map(values, slopes, low, high, position[:, 2])
    offset = np.linalg.solve(jacobian, (vertices - there)[..., None])[..., 0]
    height = position[:, 2:]
    along = np.einsum("naj,nj->na", slopes, offset[:, :2])
    moved = values + along
    weights = np.concatenate(
        [moved * (1.0 - height) - values * offset[:, 2:], moved * height + values * offset[:, 2:]],
        axis=1,
    )
    steep = np.flatnonzero(np.abs(weights).max(axis=1) > _MAX_WEIGHT)
    flat = np.concatenate([values * (1.0 - height), values * height], axis=1)[steep]
    nodes = np.concatenate([low, high], axis=1)[steep]
    weights[steep] = _least_change(flat, nodes, vertices[steep])
    return Embedding(np.concatenate([inner, outer], axis=1)[triangle], weights)


def _least_change(
    weights: Float[np.ndarray, "k 12"],
    nodes: Float[np.ndarray, "k 12 3"],
    points: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "k 12"]:
    """Weights nearest to the given ones that sum to 1 and reproduce the points."""
    center = nodes.mean(axis=1, keepdims=True)
    around = nodes - center
    size = np.linalg.norm(around, axis=2).max(axis=1)[:, None, None]
    rows = np.concatenate([np.ones((len(nodes), 12, 1)), around / size], axis=2)
    wanted = np.concatenate([np.ones((len(nodes), 1, 1)), (points[:, None] - center) / size], 2)
    missing = wanted[:, 0] - np.einsum("ka,kai->ki", weights, rows)
    correction = np.linalg.solve(rows.swapaxes(1, 2) @ rows, missing[..., None])
    return weights + (rows @ correction)[..., 0]


def _covered(position: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Nearest coordinates within the prism."""
    corner = np.column_stack([1.0 - position[:, :2].sum(axis=1), position[:, :2]]).clip(0.0)
    corner /= corner.sum(axis=1, keepdims=True)
    return np.column_stack([corner[:, 1:], position[:, 2].clip(0.0, 1.0)])


def _map(
    values: Float[np.ndarray, "n 6"],
    slopes: Float[np.ndarray, "n 6 2"],
    low: Float[np.ndarray, "n 6 3"],
    high: Float[np.ndarray, "n 6 3"],
    height: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3"]]:
    """Jacobian and value of x = Σ N (low + height (high − low))."""
    nodes = low + height[:, None, None] * (high - low)
    across = np.einsum("na,nai->ni", values, high - low)
    along = np.einsum("nai,naj->nij", nodes, slopes)
    return np.concatenate([along, across[..., None]], axis=-1), np.einsum(
        "na,nai->ni", values, nodes
    )


def _locate(
    coarsened: Coarsened, layer: Layer
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Triangle of each smoothed vertex and its coordinates (ξ, η, height in thicknesses)."""
    inner, outer = coarsened.surface.triangles, layer.outer_triangles
    order = np.argsort(inner[:, :3].ravel(), kind="stable")
    corner = inner[:, :3].ravel()[order]
    start = np.searchsorted(corner, np.arange(len(coarsened.surface.nodes) + 1))
    first, count = start[coarsened.cell], np.diff(start)[coarsened.cell]
    best = np.full(len(coarsened.cell), -np.inf)
    triangle = np.zeros(len(best), int)
    position = np.zeros((len(best), 3))
    for k in range(int(count.max())):
        rows = np.flatnonzero(count > k)
        candidate = order[first[rows] + k] // 3
        low, high = layer.nodes[inner[candidate]], layer.nodes[outer[candidate]]
        inverse = _invert(coarsened.smooth[rows], low, high)
        depth = np.minimum(inverse[:, :2].min(axis=1), 1.0 - inverse[:, :2].sum(axis=1))
        # Far outside, the inverse of the curved map may lie on another branch.
        depth = np.where(np.abs(inverse).max(axis=1) < 10.0, depth, -1e9)
        better = depth > best[rows]
        rows = rows[better]
        best[rows], triangle[rows], position[rows] = (
            depth[better],
            candidate[better],
            inverse[better],
        )
    return triangle, position


def _invert(
    points: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "n 6 3"],
    high: Float[np.ndarray, "n 6 3"],
) -> Float[np.ndarray, "n 3"]:
    """Newton iterations for the coordinates (ξ, η, height) of points, kept near the triangle."""
    position = np.tile([1.0 / 3.0, 1.0 / 3.0, 0.0], (len(points), 1))
    for _ in range(_ROUNDS):
        values, slopes = shapes(position[:, :2])
        jacobian, there = _map(values, slopes, low, high, position[:, 2])
        offset = np.linalg.solve(jacobian, (points - there)[..., None])[..., 0]
        position = np.clip(position + offset, -2.0, 3.0)
    return position
