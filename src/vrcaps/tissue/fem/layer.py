"""Layer of quadratic tetrahedra extruded from a surface of curved triangles.

The nodes of a tetrahedron are the four corners, then the midpoints of edges 01, 12, 02, 03, 13,
23, in the order of Hughes, The Finite Element Method, 1987, appendix 3.I, with edges from corner
to corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError

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
    for abscissas in product(range(num), repeat=dim):
        left, point, weight = 1.0, [], 1.0
        for k, abscissa in enumerate(abscissas):
            fraction = 0.5 * (1.0 + rules[k][0][abscissa])
            point.append(left * fraction)
            left *= 1.0 - fraction
            weight *= rules[k][1][abscissa] / 2.0 ** (dim - k)
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
    abscissas, point_weights = quadrature(3, num)
    values, slopes = shapes(abscissas)
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


# Three tetrahedra of a prism whose corners are sorted by vertex index; 3 to 5 are outside.
# Every side is cut from its inner corner of lower index, so that neighbors agree.
_CUTS = ((0, 1, 2, 5), (0, 1, 5, 4), (0, 4, 5, 3))


@dataclass(frozen=True)
class CoarseSurface:
    """Curved triangles of six nodes, counter-clockwise as seen from the lumen.

    Attributes:
        nodes: Positions [m].
        outward: Unit directions away from the lumen.
        triangles: Three corners of each, then the midpoints of its edges 01, 12, 02.
    """

    nodes: Float[np.ndarray, "n 3"]
    outward: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 6"]


@dataclass(frozen=True)
class Layer:
    """Tetrahedra of ten nodes between an inner and an outer surface.

    Node `level · n + k` lies over node k of the surface; level 0 is inside.

    Attributes:
        surface: The inner surface.
        nodes: Positions [m].
        tetrahedra: Nodes of each, in the order of `elements`.
        thickness: Thickness of the layer [m].
        num_levels: Number of node levels: two per element through the thickness, plus one.
    """

    surface: CoarseSurface
    nodes: Float[np.ndarray, "nodes 3"]
    tetrahedra: Int[np.ndarray, "m 10"]
    thickness: float
    num_levels: int

    @property
    def outer_triangles(self) -> Int[np.ndarray, "m 6"]:
        """Nodes of the triangles of the outer surface."""
        return self.surface.triangles + (self.num_levels - 1) * len(self.surface.nodes)


def extrude(surface: CoarseSurface, thickness: float, layers: int) -> Layer:
    """Extrude a surface outwards into a layer.

    Raises:
        InputError: If the layer folds over itself.
    """
    num_levels = 2 * layers + 1
    heights = np.linspace(0.0, thickness, num_levels)
    nodes = (surface.nodes + heights[:, None, None] * surface.outward).reshape(-1, 3)
    count = len(surface.nodes)
    bottom = _prism_tetrahedra(surface.triangles, count)
    tetrahedra = np.concatenate([bottom + 2 * k * count for k in range(layers)])
    _check_volumes(nodes, tetrahedra, thickness)
    return Layer(surface, nodes, tetrahedra, thickness, num_levels)


def _prism_tetrahedra(triangles: Int[np.ndarray, "m 6"], count: int) -> Int[np.ndarray, "k 10"]:
    """Tetrahedra of prisms over triangles, with three levels of `count` nodes each."""
    order = np.argsort(triangles[:, :3], axis=1)
    corner = np.take_along_axis(triangles[:, :3], order, axis=1)
    # Midpoint between two corners of a triangle, by their positions in it.
    middle = np.full((len(triangles), 3, 3), -1)
    for k, (a, b) in enumerate(EDGES[:3]):
        middle[:, a, b] = middle[:, b, a] = triangles[:, 3 + k]
    rows = np.arange(len(triangles))
    tetrahedra_of_prism = []
    for cut in _CUTS:
        columns = [corner[:, c % 3] + 2 * (c // 3) * count for c in cut]
        for a, b in EDGES:
            p, q = cut[a], cut[b]
            level = p // 3 + q // 3
            flat = (
                corner[:, p % 3]
                if p % 3 == q % 3
                else middle[rows, order[:, p % 3], order[:, q % 3]]
            )
            columns.append(flat + level * count)
        tetrahedra_of_prism.append(np.stack(columns, axis=1))
    # Sorting reversed the orientation of some triangles.
    turned = np.linalg.det(np.eye(3)[order]) > 0.0
    flip = [1, 0, 2, 3, 4, 6, 5, 8, 7, 9]
    tetrahedra = np.stack(tetrahedra_of_prism, axis=1)
    tetrahedra[turned] = tetrahedra[turned][:, :, flip]
    return tetrahedra.reshape(-1, 10)


def thinnest(surface: CoarseSurface, thickness: float) -> Float[np.ndarray, " m"]:
    """Minimum nodal volume of each triangle's layer relative to its mean; negative if it folds."""
    count = len(surface.nodes)
    heights = np.array([0.0, 0.5, 1.0]) * thickness
    nodes = (surface.nodes + heights[:, None, None] * surface.outward).reshape(-1, 3)
    tetrahedra = _prism_tetrahedra(surface.triangles, count)
    volumes = corner_volumes(nodes, tetrahedra).reshape(len(surface.triangles), -1)
    return volumes.min(axis=1) / np.abs(volumes).mean(axis=1)


def _check_volumes(
    nodes: Float[np.ndarray, "n 3"], tetrahedra: Int[np.ndarray, "m 10"], thickness: float
) -> None:
    points = integration_points(nodes, tetrahedra, 2)
    volumes = np.concatenate([corner_volumes(nodes, tetrahedra), points.weights], axis=1)
    inverted = volumes.min(axis=1) <= 0.0
    if not inverted.any():
        return
    x, y, z = 1e3 * nodes[tetrahedra[inverted][0, 0]]
    raise InputError(
        f"The layer folds over itself at {inverted.sum()} of {len(inverted)} elements, one at "
        f"({x:.0f}, {y:.0f}, {z:.0f}) mm: thickness is {1e3 * thickness:g} mm, more than the "
        "wall's radius of curvature there. Give a smaller thickness or a larger edge."
    )
