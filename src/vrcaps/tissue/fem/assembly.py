"""Mass, stiffness and support of a layer, over pairs of its free nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tissue.fem.elements import integration_points, quadrature, shapes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.tissue.fem.deformation import FemDeformation
    from vrcaps.tissue.fem.layer import Layer


@dataclass(frozen=True)
class Matrices:
    """Lower triangles over pairs of free nodes, by rows; the diagonal ends each row.

    Attributes:
        starts: Where each row starts, and the end of the last.
        columns: Column of each pair.
        mass: Mass of each pair [kg], the same for x, y and z.
        support: Support's stiffness of each pair [N/m], the same for x, y and z.
        stiffness: Stiffness of each pair at rest, the support's included [N/m].
        node_mass: Mass at each free node that a uniform acceleration moves [kg].
    """

    starts: Int[np.ndarray, " rows+1"]
    columns: Int[np.ndarray, " pairs"]
    mass: Float[np.ndarray, " pairs"]
    support: Float[np.ndarray, " pairs"]
    stiffness: Float[np.ndarray, "pairs 3 3"]
    node_mass: Float[np.ndarray, " rows"]


@dataclass(frozen=True)
class ElementPoints:
    """What the stress of a nonlinear wall is summed over.

    Attributes:
        nodes: Nodes of each element, free ones first.
        gradients: Gradients of the shape functions at each point [1/m].
        weights: Volume of each point [m³].
        shear: Shear modulus μ [Pa].
        lame: Lamé's first parameter λ [Pa].
        stiffening: Coefficient b of the exponential.
    """

    nodes: Int[np.ndarray, "m 10"]
    gradients: Float[np.ndarray, "m points 10 3"]
    weights: Float[np.ndarray, "m points"]
    shear: float
    lame: float
    stiffening: float


def element_stiffness(
    gradients: Float[np.ndarray, "m points a 3"],
    weights: Float[np.ndarray, "m points"],
    lame: float,
    shear: float,
) -> Float[np.ndarray, "m a a 3 3"]:
    """Hooke's law: Σ w (λ gₐ gᵦᵀ + μ gᵦ gₐᵀ + μ gₐ·gᵦ I) between nodes a and b [N/m]."""
    weighted = gradients * weights[..., None, None]
    outer = np.einsum("eqai,eqbj->eabij", weighted, gradients, optimize=True)
    inner = np.einsum("eabii->eab", outer)
    return lame * outer + shear * (outer.swapaxes(-1, -2) + inner[..., None, None] * np.eye(3))


def element_mass(
    nodes: Float[np.ndarray, "n 3"], tetrahedra: Int[np.ndarray, "m 10"], density: float
) -> Float[np.ndarray, "m 10 10"]:
    """Consistent mass ρ ∫ NₐNᵦ dV [kg]."""
    points = integration_points(nodes, tetrahedra, 3)
    return density * np.einsum("eq,qa,qb->eab", points.weights, points.values, points.values)


def surface_mass(
    nodes: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 6"]
) -> Float[np.ndarray, "m 6 6"]:
    """∫ NₐNᵦ dA over curved triangles [m²]."""
    places, shares = quadrature(2, 3)
    values, slopes = shapes(places)
    tangents = np.einsum("eai,qaj->eqji", nodes[triangles], slopes)
    area = np.linalg.norm(np.cross(tangents[..., 0, :], tangents[..., 1, :]), axis=-1) * shares
    return np.einsum("eq,qa,qb->eab", area, values, values)


def assemble(
    layer: Layer, deformation: FemDeformation, number: Int[np.ndarray, " nodes"], num_free: int
) -> Matrices:
    """Matrices of a layer; `number` numbers its nodes, the free ones first."""
    points = integration_points(layer.nodes, layer.tetrahedra, 2)
    stiffness = element_stiffness(
        points.gradients, points.weights, deformation.lame, deformation.shear
    )
    mass = element_mass(layer.nodes, layer.tetrahedra, deformation.density)
    outer = surface_mass(layer.nodes, layer.outer_triangles) * deformation.support
    body, shell = number[layer.tetrahedra], number[layer.outer_triangles]
    row, column, kept = _pairs(body, num_free)
    keys, place = np.unique(row * num_free + column, return_inverse=True)
    shell_row, shell_column, shell_kept = _pairs(shell, num_free)
    shell_place = np.searchsorted(keys, shell_row * num_free + shell_column)

    def add(values: Float[np.ndarray, " pairs"], where: Int[np.ndarray, " pairs"]) -> np.ndarray:
        return np.bincount(where, values, len(keys))

    support = add(outer[shell_kept], shell_place)
    blocks = stiffness[kept].reshape(-1, 9)
    total = np.stack([add(blocks[:, k], place) for k in range(9)], axis=1).reshape(-1, 3, 3)
    total += support[:, None, None] * np.eye(3)
    node_mass = np.bincount(body.ravel(), mass.sum(axis=2).ravel(), len(number))
    return Matrices(
        starts=np.searchsorted(keys, np.arange(num_free + 1) * num_free).astype(np.int64),
        columns=(keys % num_free).astype(np.uint32),
        mass=add(mass[kept], place),
        support=support,
        stiffness=np.ascontiguousarray(total),
        node_mass=node_mass[:num_free],
    )


def element_points(
    layer: Layer, deformation: FemDeformation, number: Int[np.ndarray, " nodes"]
) -> ElementPoints:
    """Points of a layer's elements for `neo-hookean`."""
    points = integration_points(layer.nodes, layer.tetrahedra, 2)
    return ElementPoints(
        nodes=np.ascontiguousarray(number[layer.tetrahedra], np.uint32),
        gradients=np.ascontiguousarray(points.gradients),
        weights=np.ascontiguousarray(points.weights),
        shear=deformation.shear,
        lame=deformation.lame,
        stiffening=deformation.stiffening,
    )


def _pairs(
    nodes: Int[np.ndarray, "m a"], num_free: int
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Bool[np.ndarray, "m a a"]]:
    """Rows and columns of the elements' pairs in the lower triangle, and which those are."""
    row, column = np.broadcast_arrays(nodes[:, :, None], nodes[:, None, :])
    kept = (row >= column) & (row < num_free)
    return row[kept].astype(np.int64), column[kept].astype(np.int64), kept
