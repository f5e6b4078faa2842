"""Base class of the observations of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.env.simulation import Simulation


class Observation:
    """One key of an agent's observation. Its state is in the simulation's memory.

    Subclasses are frozen dataclasses whose fields are the settings; `OBSERVATIONS.register` lets
    settings name a subclass.
    """

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """Key of the observation."""
        return self.kind

    @property
    def needs_textures(self) -> bool:
        """Return whether it renders the wall."""
        return False

    def space(self, simulation: Simulation) -> Any:
        """Observation space of one world, a `gymnasium.spaces.Box`."""
        raise NotImplementedError

    def allocate(self, simulation: Simulation) -> None:
        """Allocate state in the simulation's memory."""

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Start an episode in one world."""

    def observe(self, simulation: Simulation) -> np.ndarray:
        """Return the current observation of all worlds, in a new array."""
        raise NotImplementedError
