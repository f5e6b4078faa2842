"""Protocol of an actuation of an environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.env.simulation import Simulation
    from vrcaps.magnet.sources import Source
    from vrcaps.world.control import Control
    from vrcaps.world.model import State


class Actuation(Protocol):
    """Mapping from actions to the capsule's motion. Its state is in the simulation's memory."""

    kind: ClassVar[str]

    def space(self) -> Any:
        """Action space of one world, a `gymnasium.spaces.Space`."""
        ...

    def allocate(self, simulation: Simulation) -> None:
        """Allocate state in the simulation's memory."""
        ...

    def begin(self, simulation: Simulation, index: int, start: State) -> tuple[Source, ...]:
        """Start an episode in one world whose capsule is at `start`.

        Returns:
            External magnets at their initial poses.
        """
        ...

    def controls(
        self, simulation: Simulation, actions: np.ndarray, numbers: np.ndarray
    ) -> Sequence[Control]:
        """Return the commands of the given worlds for the next control period.

        Args:
            simulation: The worlds.
            actions: A row for each of all worlds.
            numbers: Indices of the worlds that move.
        """
        ...

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Return metrics of each world, for `info`."""
        ...
