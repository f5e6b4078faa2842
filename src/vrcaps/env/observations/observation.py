"""Observation: what every observation of an environment answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.env.simulation import Simulation


class Observation(Protocol):
    """One key of what an agent sees. What changes lies in the simulation's memory."""

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """Its key."""
        ...

    @property
    def needs_textures(self) -> bool:
        """Whether it renders the wall."""
        ...

    def space(self, simulation: Simulation) -> Any:
        """Space of one world's observation, a `gymnasium.spaces.Box`."""
        ...

    def allocate(self, simulation: Simulation) -> None:
        """Make room in the simulation's memory."""
        ...

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Begin an episode in one world."""
        ...

    def observe(self, simulation: Simulation) -> np.ndarray:
        """What is seen in all worlds now, in an array of its own."""
        ...
