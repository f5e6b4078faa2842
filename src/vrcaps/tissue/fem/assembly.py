"""Assembly of the mass, stiffness and support matrices of a layer over its free nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.tissue.fem.layer import Points, integration_points, quadrature, shapes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.tissue.fem.deformation import FemDeformation
    from vrcaps.tissue.fem.layer import Layer


@dataclass(frozen=True)
class Matrices:
    """Lower triangles of the matrices over free nodes, in row order; each row ends on its diagonal.

    Attributes:
        starts: Index of the first entry of each row, then the number of entries.
        columns: Column of each entry.
        mass: Mass of each entry [kg], the same for x, y and z.
        support: Stiffness of the support at each entry [N/m], the same for x, y and z.
        stiffness: Stiffness of each entry at rest, including the support [N/m].
        node_mass: Mass at each free node that responds to a uniform acceleration [kg].
    """

    starts: Int[np.ndarray, " rows+1"]
    columns: Int[np.ndarray, " pairs"]
    mass: Float[np.ndarray, " pairs"]
    support: Float[np.ndarray, " pairs"]
    stiffness: Float[np.ndarray, "pairs 3 3"]
    node_mass: Float[np.ndarray, " rows"]


@dataclass(frozen=True)
class ElementPoints:
    """Integration points over which the stress of a nonlinear wall is summed.

    Attributes:
        nodes: Nodes of each element, free ones first.
        gradients: Gradients of the shape functions at each point [1/m].
        weights: Volume of each point [m³].
        modes: Linear functions at the points of each prism of three elements, see `prism_modes`.
        shear: Shear modulus μ [Pa].
        lame: Lamé's first parameter λ [Pa].
        stiffening: Coefficient b of the exponential.
    """

    nodes: Int[np.ndarray, "m 10"]
    gradients: Float[np.ndarray, "m points 10 3"]
    weights: Float[np.ndarray, "m points"]
    modes: Float[np.ndarray, "prisms 3*points 4"]
    shear: float
    lame: float
    stiffening: float


def prism_modes(
    points: Points, nodes: Float[np.ndarray, "n 3"], tetrahedra: Int[np.ndarray, "m 10"]
) -> Float[np.ndarray, "prisms 3*points 4"]:
    """Linear functions over each prism of three elements, orthonormal under volume [m^-3/2].

    The change of volume is projected onto these functions, so that a nearly incompressible layer
    does not lock: a prism with 18 degrees of freedom has 4 constraints instead of the 24 of its
    integration points. Because the functions are linear, bending and the patch test keep their full
    stress (mean dilatation: Hughes, The Finite Element Method, 1987, 4.5, here of first order).
    """
    position = np.einsum("qa,eai->eqi", points.values, nodes[tetrahedra])
    position = position.reshape(-1, 3 * len(points.values), 3)
    weights = points.weights.reshape(len(position), -1, 1)
    position = position - (weights * position).sum(1, keepdims=True) / weights.sum(1, keepdims=True)
    size = np.sqrt((position**2).sum(axis=2).max(axis=1))[:, None, None]
    linear = np.concatenate([np.ones_like(weights), position / size], axis=2)
    orthogonal, _ = np.linalg.qr(np.sqrt(weights) * linear)
    return orthogonal / np.sqrt(weights)


def dilatation(
    points: Points,
    modes: Float[np.ndarray, "prisms 3*points 4"],
    nodes: Int[np.ndarray, "m 10"],
    num_nodes: int,
) -> scipy.sparse.csr_matrix:
    """Projected volume change of displacements: four rows per prism, three columns per node."""
    weighted = points.gradients * points.weights[..., None, None]
    modes = modes.reshape(*points.weights.shape, 4)
    values = np.einsum("eqm,eqai->emai", modes, weighted)
    row = 4 * (np.arange(len(nodes)) // 3)[:, None] + np.arange(4)
    column = 3 * nodes[:, :, None] + np.arange(3)
    ends = np.broadcast_arrays(row[:, :, None, None], column[:, None])
    shape = (4 * len(nodes) // 3, 3 * num_nodes)
    return scipy.sparse.csr_matrix((values.ravel(), [end.ravel() for end in ends]), shape=shape)


def shear_stiffness(points: Points, shear: float) -> Float[np.ndarray, "m 10 10 3 3"]:
    """2 μ ε: Σ w μ (gᵦ gₐᵀ + gₐ·gᵦ I) between nodes a and b [N/m]."""
    weighted = points.gradients * points.weights[..., None, None]
    outer = np.einsum("eqai,eqbj->eabji", weighted, points.gradients, optimize=True)
    inner = np.einsum("eabii->eab", outer)
    return shear * (outer + inner[..., None, None] * np.eye(3))


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
    abscissas, point_weights = quadrature(2, 3)
    values, slopes = shapes(abscissas)
    tangents = np.einsum("eai,qaj->eqji", nodes[triangles], slopes)
    area = (
        np.linalg.norm(np.cross(tangents[..., 0, :], tangents[..., 1, :]), axis=-1) * point_weights
    )
    return np.einsum("eq,qa,qb->eab", area, values, values)


def assemble(
    layer: Layer, deformation: FemDeformation, node_index: Int[np.ndarray, " nodes"], num_free: int
) -> Matrices:
    """Assemble the matrices of a layer; `number` gives the index of each node, free nodes first."""
    points = integration_points(layer.nodes, layer.tetrahedra, 2)
    body, shell = node_index[layer.tetrahedra], node_index[layer.outer_triangles]
    modes = prism_modes(points, layer.nodes, layer.tetrahedra)
    change = dilatation(points, modes, body, len(node_index))[:, : 3 * num_free]
    volume = (deformation.lame * (change.T @ change)).tobsr((3, 3))
    volume_row = np.repeat(np.arange(num_free), np.diff(volume.indptr))
    lower = volume.indices <= volume_row
    volume_key = volume_row[lower] * num_free + volume.indices[lower]
    body_key, body_kept = _pairs(body, num_free)
    shell_key, shell_kept = _pairs(shell, num_free)
    keys = np.unique(np.concatenate([volume_key, body_key]))

    def add(key: Int[np.ndarray, " k"], values: np.ndarray) -> Float[np.ndarray, "pairs c"]:
        columns = values.reshape(len(values), -1).T
        position = np.searchsorted(keys, key)
        return np.stack([np.bincount(position, column, len(keys)) for column in columns], axis=1)

    outer = surface_mass(layer.nodes, layer.outer_triangles) * deformation.support
    support = add(shell_key, outer[shell_kept])
    stiffness = add(volume_key, volume.data[lower]) + support * np.eye(3).ravel()
    stiffness += add(body_key, shear_stiffness(points, deformation.shear)[body_kept])
    mass = element_mass(layer.nodes, layer.tetrahedra, deformation.density)
    node_mass = np.bincount(body.ravel(), mass.sum(axis=2).ravel(), len(node_index))
    return Matrices(
        starts=np.searchsorted(keys, np.arange(num_free + 1) * num_free).astype(np.int64),
        columns=(keys % num_free).astype(np.uint32),
        mass=add(body_key, mass[body_kept])[:, 0],
        support=np.ascontiguousarray(support[:, 0]),
        stiffness=np.ascontiguousarray(stiffness.reshape(-1, 3, 3)),
        node_mass=node_mass[:num_free],
    )


def element_points(
    layer: Layer, deformation: FemDeformation, node_index: Int[np.ndarray, " nodes"]
) -> ElementPoints:
    """Integration points of a layer's elements for `neo-hookean`."""
    points = integration_points(layer.nodes, layer.tetrahedra, 2)
    return ElementPoints(
        nodes=np.ascontiguousarray(node_index[layer.tetrahedra], np.uint32),
        gradients=np.ascontiguousarray(points.gradients),
        weights=np.ascontiguousarray(points.weights),
        modes=prism_modes(points, layer.nodes, layer.tetrahedra),
        shear=deformation.shear,
        lame=deformation.lame,
        stiffening=deformation.stiffening,
    )


def _pairs(
    nodes: Int[np.ndarray, "m a"], num_free: int
) -> tuple[Int[np.ndarray, " k"], Bool[np.ndarray, "m a a"]]:
    """Keys (row · count + column) of the node pairs in the lower triangle, and their mask."""
    row, column = np.broadcast_arrays(nodes[:, :, None], nodes[:, None, :])
    kept = (row >= column) & (row < num_free)
    return row[kept] * num_free + column[kept], kept
