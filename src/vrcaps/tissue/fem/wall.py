"""Finite-element wall that deforms the surface of an organ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, require
from vrcaps.tissue.fem.assembly import assemble, element_points
from vrcaps.tissue.fem.coarse import Coarsened, coarsen
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.embedding import Embedding, embed
from vrcaps.tissue.fem.layer import extrude

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.organ.surface import OrganSurface

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
