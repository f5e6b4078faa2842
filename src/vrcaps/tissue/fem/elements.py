"""Quadratic tetrahedron: shape functions, integration points, geometry.

The nodes are the four corners, then the midpoints of edges 01, 12, 02, 03, 13, 23, in the order of
Hughes, The Finite Element Method, 1987, appendix 3.I, with edges from corner to corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float, Int

EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Corners of the edges whose midpoints are nodes 4 to 9; the first three form a triangle."""


def quadrature(
    dim: int, num: int
) -> tuple[Float[np.ndarray, "points dim"], Float[np.ndarray, " points"]]:
    """Quadrature points and weights on the unit simplex, exact to degree 2·num − 1.

    Conical product of Gauss-Jacobi rules (Stroud, Approximate Calculation of Multiple
    Integrals, 1971, 2.4); all weights are positive at every degree.
    """
    rules = [scipy.special.roots_jacobi(num, float(k), 0.0) for k in reversed(range(dim))]
    points, weights = [], []
    for places in product(range(num), repeat=dim):
        left, point, weight = 1.0, [], 1.0
        for k, place in enumerate(places):
            fraction = 0.5 * (1.0 + rules[k][0][place])
            point.append(left * fraction)
            left *= 1.0 - fraction
            weight *= rules[k][1][place] / 2.0 ** (dim - k)
        points.append(point)
        weights.append(weight)
    return np.array(points), np.array(weights)


def shapes(
    points: Float[np.ndarray, "*points dim"],
) -> tuple[Float[np.ndarray, "*points nodes"], Float[np.ndarray, "*points nodes dim"]]:
    """Quadratic shape functions and their derivatives on the unit triangle or tetrahedron.

    6 nodes for points in two dimensions, 10 in three.
    """
    dim = points.shape[-1]
    corner = np.concatenate([1.0 - points.sum(-1, keepdims=True), points], axis=-1)
    slope = np.concatenate([-np.ones((1, dim)), np.eye(dim)])
    edges = EDGES[:3] if dim == 2 else EDGES
    values = [corner[..., k] * (2.0 * corner[..., k] - 1.0) for k in range(dim + 1)]
    slopes = [(4.0 * corner[..., k, None] - 1.0) * slope[k] for k in range(dim + 1)]
    for a, b in edges:
        values.append(4.0 * corner[..., a] * corner[..., b])
        slopes.append(4.0 * (corner[..., a, None] * slope[b] + corner[..., b, None] * slope[a]))
    return np.stack(values, axis=-1), np.stack(slopes, axis=-2)


@dataclass(frozen=True)
class Points:
    """Integration points of a mesh of tetrahedra.

    Attributes:
        values: Shape functions at the points of one element.
        gradients: Their gradients [1/m].
        weights: Volume of each point [m³]; negative in inverted elements.
    """

    values: Float[np.ndarray, "points 10"]
    gradients: Float[np.ndarray, "m points 10 3"]
    weights: Float[np.ndarray, "m points"]


def integration_points(
    nodes: Float[np.ndarray, "n 3"], tetrahedra: Int[np.ndarray, "m 10"], num: int
) -> Points:
    """Integration points of curved (isoparametric) tetrahedra, `num` per side."""
    places, point_weights = quadrature(3, num)
    values, slopes = shapes(places)
    jacobian = np.einsum("eai,qaj->eqij", nodes[tetrahedra], slopes)
    determinant = np.linalg.det(jacobian)
    flat = determinant == 0.0
    jacobian[flat] = np.eye(3)
    gradients = np.einsum("qaj,eqji->eqai", slopes, np.linalg.inv(jacobian))
    return Points(values, gradients, determinant * point_weights)


def corner_volumes(
    nodes: Float[np.ndarray, "n 3"], tetrahedra: Int[np.ndarray, "m 10"]
) -> Float[np.ndarray, "m 10"]:
    """Jacobian determinant of the map from the unit tetrahedron, at its nodes [m³]."""
    corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    middles = np.array([0.5 * (corners[a] + corners[b]) for a, b in EDGES])
    _, slopes = shapes(np.concatenate([corners, middles]))
    return np.linalg.det(np.einsum("eai,qaj->eqij", nodes[tetrahedra], slopes))
