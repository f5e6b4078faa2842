"""Base class of the tasks of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.rewards import Reward
    from vrcaps.env.simulation import Simulation


class Task:
    """Task of an agent. Subclasses are frozen dataclasses whose fields are the task's settings.

    The state of a task is in the simulation's memory. All arrays have a row for each world.
    `TASKS.register` lets settings and the command line name a subclass.
    """

    kind: ClassVar[str]

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Default rewards."""
        raise NotImplementedError

    @property
    def defaults(self) -> dict[str, Any]:
        """Default settings by name, for those missing from `env_settings`."""
        return {}

    def allocate(self, simulation: Simulation) -> None:
        """Allocate state in the simulation's memory."""

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Start an episode in one world."""

    def update(self, simulation: Simulation, numbers: np.ndarray) -> None:
        """Update the state after a step of some of the worlds."""

    def progress(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """Progress of the task, 0 to 1."""
        raise NotImplementedError

    def is_done(self, simulation: Simulation) -> Bool[np.ndarray, " n"]:
        """Return whether the task is completed: by default, at full progress."""
        return self.progress(simulation) >= 1.0

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Return metrics, for `info`."""
        return {}
