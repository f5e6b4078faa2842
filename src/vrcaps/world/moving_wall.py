"""Moving wall: one hierarchy, refitted to one state after another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.mesh.mesh import wall_of

if TYPE_CHECKING:
    from vrcaps.world.model import Model, State


class MovingWall:
    """Holds one wall and moves it to a state, once for all who ask for the same."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._wall: Wall | None = None
        self._vertices: np.ndarray | None = None

    def at(self, state: State) -> Wall:
        """The wall in a state, ready for queries and images until another state is asked for.

        A state's arrays are taken not to change.
        """
        if state.vertices_world is None:
            return self.model.wall
        if self._wall is None:
            # Built at rest: the hierarchy, and so which of several equally near triangles counts,
            # must not depend on which frame came first.
            self._wall = wall_of(self.model.vertices_world, self.model.organ.faces)
        if self._vertices is not state.vertices_world:
            self._wall.refit(np.ascontiguousarray(state.vertices_world, np.float64))
            self._vertices = state.vertices_world
        return self._wall
