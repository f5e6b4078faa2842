"""Protocol of an observation of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.env.simulation import Simulation


class Observation(Protocol):
    """One key of an agent's observation. Its state is in the simulation's memory."""

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """Key of the observation."""
        ...

    @property
    def needs_textures(self) -> bool:
        """Return whether it renders the wall."""
        ...

    def space(self, simulation: Simulation) -> Any:
        """Observation space of one world, a `gymnasium.spaces.Box`."""
        ...

    def allocate(self, simulation: Simulation) -> None:
        """Allocate state in the simulation's memory."""
        ...

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Start an episode in one world."""
        ...

    def observe(self, simulation: Simulation) -> np.ndarray:
        """Return the current observation of all worlds, in a new array."""
        ...
