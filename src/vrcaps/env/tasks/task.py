"""Protocol of a task of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool, Float

    from vrcaps.env.rewards import Reward
    from vrcaps.env.simulation import Simulation


class Task(Protocol):
    """Task of an agent. Its state is in the simulation's memory.

    All arrays have a row for each world.
    """

    kind: ClassVar[str]

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Default rewards."""
        ...

    @property
    def defaults(self) -> dict[str, Any]:
        """Default settings by name, for those missing from `env_settings`."""
        ...

    def allocate(self, simulation: Simulation) -> None:
        """Allocate state in the simulation's memory."""
        ...

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Start an episode in one world."""
        ...

    def update(self, simulation: Simulation, numbers: np.ndarray) -> None:
        """Update the state after a step of some of the worlds."""
        ...

    def progress(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """Progress of the task, 0 to 1."""
        ...

    def is_done(self, simulation: Simulation) -> Bool[np.ndarray, " n"]:
        """Return whether the task is completed."""
        ...

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Return metrics, for `info`."""
        ...
