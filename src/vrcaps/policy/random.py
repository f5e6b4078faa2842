"""Random: actions drawn evenly from the action space, each held for some time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import rng
from vrcaps.policy.policy import Requirements

if TYPE_CHECKING:
    from vrcaps.env.vector_env import CapsuleVectorEnv

_HELD = 6
"""Actions for which one is held: at the default control period, a second."""


class RandomPolicy:
    """Draws an action a second for each world, whatever it sees."""

    requires = Requirements()

    def __init__(self) -> None:
        self._draws: dict[int, np.random.Generator] = {}
        self._age: dict[int, int] = {}
        self._actions: dict[int, np.ndarray] = {}

    def reset(self, numbers: np.ndarray, seeds: Sequence[int]) -> None:
        """Begin each world's own stream of numbers."""
        for number, seed in zip(np.asarray(numbers).tolist(), seeds, strict=True):
            self._draws[number] = rng.stream(int(seed), "policy/random")
            self._age[number] = 0

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """The actions held now."""
        space = env.single_action_space
        for number, draw in self._draws.items():
            if self._age[number] % _HELD == 0:
                self._actions[number] = _draw(space, draw)
            self._age[number] += 1
        return np.stack([self._actions[k] for k in range(env.num_envs)]).astype(space.dtype)


def _draw(space: object, draw: np.random.Generator) -> np.ndarray:
    """One action of a box or of a discrete space."""
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if low is not None and high is not None:
        return draw.uniform(low, high)
    count, start = int(space.n), int(space.start)  # type: ignore[attr-defined]
    return np.asarray(start + draw.integers(count))
