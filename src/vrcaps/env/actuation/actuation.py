"""Actuation: what every actuation of an environment answers."""

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
    """How an action moves the capsule. What changes lies in the simulation's memory."""

    kind: ClassVar[str]

    def space(self) -> Any:
        """Space of one world's actions, a `gymnasium.spaces.Space`."""
        ...

    def allocate(self, simulation: Simulation) -> None:
        """Make room in the simulation's memory."""
        ...

    def begin(self, simulation: Simulation, index: int, start: State) -> tuple[Source, ...]:
        """Begin an episode in one world whose capsule is at `start`.

        Returns:
            Magnets outside, where they are then.
        """
        ...

    def controls(
        self, simulation: Simulation, actions: np.ndarray, numbers: np.ndarray
    ) -> Sequence[Control]:
        """Commands of the next control period for the worlds of some numbers.

        Args:
            simulation: The worlds.
            actions: A row for each of all worlds.
            numbers: Worlds that move.
        """
        ...

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """What it says of each world, for `info`."""
        ...
