"""Base class of the actuations of an environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.env.simulation import Simulation
    from vrcaps.magnet.sources import Source
    from vrcaps.world.control import Control
    from vrcaps.world.model import State


class Actuation:
    """Mapping from actions to the capsule's motion. Its state is in the simulation's memory.

    Subclasses are frozen dataclasses whose fields are the settings; `ACTUATIONS.register` lets
    settings and the command line name a subclass.
    """

    kind: ClassVar[str]

    def space(self) -> Any:
        """Action space of one world, a `gymnasium.spaces.Space`."""
        raise NotImplementedError

    def allocate(self, simulation: Simulation) -> None:
        """Allocate state in the simulation's memory."""

    def begin(self, simulation: Simulation, index: int, start: State) -> tuple[Source, ...]:
        """Start an episode in one world whose capsule is at `start`.

        Returns:
            External magnets at their initial poses.
        """
        return ()

    def controls(
        self, simulation: Simulation, actions: np.ndarray, numbers: np.ndarray
    ) -> Sequence[Control]:
        """Return the commands of the given worlds for the next control period.

        Args:
            simulation: The worlds.
            actions: A row for each of all worlds.
            numbers: Indices of the worlds that move.
        """
        raise NotImplementedError

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Return metrics of each world, for `info`."""
        return {}
