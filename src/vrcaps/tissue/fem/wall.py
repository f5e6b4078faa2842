"""Finite-element wall: the fine surface of an organ is embedded in a coarse layer that deforms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.tissue.fem.assembly import assemble, element_points
from vrcaps.tissue.fem.coarse import Coarsened, coarsen
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.layer import extrude, shapes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.organ.surface import OrganSurface
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


_LONGEST_STEP = 1.0
# Tolerance of a step of a nonlinear wall, as a fraction of the thickness.
_TOLERANCE = 1e-6


class FemWall:
    """Wall of an organ as an elastic layer, with its matrices, their factorization and its motion.

    Positions and forces are in the organ frame. The same initial state and steps give identical
    bytes with any number of threads.

    Attributes:
        deformation: Parameters of the wall.
        layer: Elements of the wall.
        node_index: Index of each node of the layer in the core; free nodes come first.
        num_free: Number of free nodes.
        embedding: Weights of the organ's vertices on the nodes, by these indices.
    """

    def __init__(self, organ: OrganSurface, deformation: FemDeformation) -> None:
        """Build the layer under an organ's surface and precompute its matrices.

        Raises:
            InputError: If the layer folds over itself, its edges are too long for the organ, or
                nothing holds it.
        """
        self.deformation = deformation
        coarsened = coarsen(organ.vertices, organ.faces, deformation.edge, deformation.thickness)
        self.layer = extrude(coarsened.surface, deformation.thickness, deformation.layers)
        over = _fixed_nodes(organ, deformation, coarsened)
        _check_fixed(over, deformation)
        is_fixed = np.tile(over, self.layer.num_levels)
        self.num_free = int((~is_fixed).sum())
        node_index = np.empty(len(is_fixed), np.int64)
        node_index[np.argsort(is_fixed, kind="stable")] = np.arange(len(is_fixed))
        self.node_index = node_index
        embedding = embed(organ.vertices, coarsened, self.layer)
        self.embedding = Embedding(
            np.ascontiguousarray(node_index[embedding.nodes], np.uint32),
            np.ascontiguousarray(embedding.weights),
        )
        matrices = assemble(self.layer, deformation, node_index, self.num_free)
        is_linear = deformation.model == "linear"
        points = None if is_linear else element_points(self.layer, deformation, node_index)
        self._core = _core.FemLayer(matrices, points, self.embedding, deformation.damping)

    @property
    def num_dof(self) -> int:
        """Degrees of freedom: three for each free node."""
        return 3 * self.num_free

    @property
    def rounds(self) -> int:
        """Number of back-substitutions in the last step."""
        return self._core.rounds

    @property
    def wall_displacement(self) -> Float[np.ndarray, "n 6"]:
        """Displacement [m] and velocity [m/s] of each vertex of the organ."""
        return self._core.wall_displacement()

    @property
    def energies(self) -> tuple[float, float]:
        """Kinetic energy, and energy stored in the wall and its support [J]."""
        return self._core.energies()

    def step(
        self,
        force_on_vertices: Float[np.ndarray, "n 3"],
        dt: float,
        *,
        acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Advance by a time `dt` [s] with implicit Euler.

        A change of `dt` costs a new factorization.

        Args:
            force_on_vertices: Force on each vertex of the organ [N].
            dt: Time step [s].
            acceleration: Body force b per mass [m/s²], in addition to that which the wall at rest
                balances.

        Returns:
            Displacement [m] and velocity [m/s] of each vertex of the organ.

        Raises:
            InputError: If the force or the step is out of bounds; the wall is then unchanged.
        """
        require(0.0 < dt <= _LONGEST_STEP, "dt", dt, f"above 0 to {_LONGEST_STEP:g} s")
        force = np.ascontiguousarray(force_on_vertices, float)
        if force.shape != (len(self.embedding.weights), 3):
            raise InputError(
                f"force_on_vertices has the shape {force.shape}. Allowed: one row of 3 for each of "
                f"the {len(self.embedding.weights)} vertices."
            )
        for name, value in (("force_on_vertices", force), ("acceleration", acceleration)):
            if not np.isfinite(value).all():
                raise InputError(f"{name} is not finite. Allowed: finite numbers.")
        x, y, z = acceleration
        tolerance = _TOLERANCE * self.deformation.thickness
        try:
            self._core.step(force, (x, y, z), dt, tolerance)
        except ValueError as error:
            raise InputError(str(error)) from error
        wall_displacement = self.wall_displacement
        return wall_displacement[:, :3], wall_displacement[:, 3:]

    def carry(self, world: _core.World) -> None:
        """Couple the layer to the wall of a world: contact on the wall loads the layer."""
        world.set_layer(self._core, _TOLERANCE * self.deformation.thickness)

    def num_steps(self, dt: float) -> int:
        """Number of layer steps in a time `dt` [s], each at most `deformation.step` long."""
        return max(1, math.ceil(dt / self.deformation.step * (1.0 - 1e-9)))

    def snapshot(self) -> Float[np.ndarray, "nodes 6"]:
        """Displacement [m] and velocity [m/s] of the free nodes: the complete state."""
        return self._core.nodes

    def restore(self, snapshot: Float[np.ndarray, "nodes 6"]) -> None:
        """Restore a snapshot of a wall of the same organ and deformation.

        Raises:
            InputError: If the snapshot is of another wall or not finite.
        """
        if snapshot.shape != (self.num_free, 6):
            raise InputError(
                f"The snapshot has the shape {snapshot.shape}, this wall's is "
                f"({self.num_free}, 6). Give a snapshot of the same organ and deformation."
            )
        if not np.isfinite(snapshot).all():
            raise InputError("The snapshot is not finite. Allowed: finite numbers.")
        self._core.nodes = np.ascontiguousarray(snapshot, float)


def _fixed_nodes(
    organ: OrganSurface, deformation: FemDeformation, coarsened: Coarsened
) -> Bool[np.ndarray, " nodes"]:
    """Nodes of the coarse surface that are held."""
    arc_length = organ.arc_length[coarsened.nearest]
    is_fixed = np.zeros(len(arc_length), bool)
    if deformation.fix_ends:
        is_fixed[coarsened.border] = True
    for start, end in deformation.fixed:
        is_fixed |= (arc_length >= start) & (arc_length <= end)
    return is_fixed


def _check_fixed(is_fixed: Bool[np.ndarray, " nodes"], deformation: FemDeformation) -> None:
    if is_fixed.all():
        raise InputError("fixed covers the whole wall. Give shorter intervals.")
    if deformation.support == 0.0 and is_fixed.sum() < 2:
        raise InputError(
            "Nothing holds the wall: support is 0 and no node is fixed. Give a support above 0, "
            "stretches in fixed, or an organ with open ends and fix_ends."
        )
