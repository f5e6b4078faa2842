"""Moving wall: one hierarchy, refitted to successive states."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.mesh.mesh import wall_of

if TYPE_CHECKING:
    from vrcaps.world.model import Model, State


class MovingWall:
    """One wall that is refitted to a state, once for all queries of that state."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._wall: Wall | None = None
        self._vertices: np.ndarray | None = None

    def at(self, state: State) -> Wall:
        """Wall in a state, valid for queries and images until another state is requested.

        The arrays of a state are assumed not to change.
        """
        if state.vertices_world is None:
            return self.model.wall
        if self._wall is None:
            # Built at rest: the hierarchy, and so the choice among equally near triangles, must not
            # depend on the first requested frame.
            self._wall = wall_of(self.model.vertices_world, self.model.organ.faces)
        if self._vertices is not state.vertices_world:
            self._wall.refit(np.ascontiguousarray(state.vertices_world, np.float64))
            self._vertices = state.vertices_world
        return self._wall
