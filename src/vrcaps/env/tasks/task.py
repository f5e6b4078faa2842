"""Task: what every task of an environment answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool, Float

    from vrcaps.env.rewards import Reward
    from vrcaps.env.simulation import Simulation


class Task(Protocol):
    """What is to be done. What changes in an episode lies in the simulation's memory.

    All arrays have a row for each world.
    """

    kind: ClassVar[str]

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Rewards that suit it."""
        ...

    @property
    def defaults(self) -> dict[str, Any]:
        """Settings that suit it, by name: those of `env_settings` that are not given."""
        ...

    def allocate(self, simulation: Simulation) -> None:
        """Make room in the simulation's memory."""
        ...

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Begin an episode in one world."""
        ...

    def update(self, simulation: Simulation, numbers: np.ndarray) -> None:
        """Take in a step of some of the worlds."""
        ...

    def progress(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """How far it is done, 0 to 1."""
        ...

    def is_done(self, simulation: Simulation) -> Bool[np.ndarray, " n"]:
        """Whether it is done."""
        ...

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """What it is judged by, for `info`."""
        ...
