"""Random policy: a new random target every second, or random actions if the servo cannot drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.core.geometry import unit
from vrcaps.core.units import CM
from vrcaps.policy.policy import Requirements
from vrcaps.policy.servo import SERVO_ACTUATIONS, Goal, servo_actions

if TYPE_CHECKING:
    from vrcaps.env.vector_env import CapsuleVectorEnv

_HELD = 6
"""Actions for which a choice is held: one second at the default control period."""

_FAR = 10.0 * CM
"""Distance of the target position."""


class RandomPolicy:
    """Random walk at constant speed, independent of observations.

    Random forces would not be a useful baseline: with inertia they throw the capsule about. For an
    actuation that the servo cannot drive, actions are drawn uniformly from the action space.
    """

    requires = Requirements()

    def __init__(self) -> None:
        self._draws: dict[int, np.random.Generator] = {}
        self._age: dict[int, int] = {}
        self._held: dict[int, np.ndarray] = {}

    def reset(self, numbers: np.ndarray, seeds: Sequence[int]) -> None:
        """Start a random stream for each world."""
        for number, seed in zip(np.asarray(numbers).tolist(), seeds, strict=True):
            self._draws[number] = rng.stream(int(seed), "policy/random")
            self._age[number] = 0

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return the current actions."""
        is_walk = env.settings.actuation.kind in SERVO_ACTUATIONS
        space = env.single_action_space
        for number in range(env.num_envs):
            if self._age[number] % _HELD == 0:
                draw = self._draws[number]
                self._held[number] = (
                    unit(draw.normal(size=(2, 3))) if is_walk else _action(space, draw)
                )
            self._age[number] += 1
        held = np.stack([self._held[k] for k in range(env.num_envs)])
        if not is_walk:
            return held.astype(space.dtype)
        simulation = env.episode.simulation
        position = simulation.T_world_capsule[:, :3, 3] + _FAR * held[:, 0]
        return servo_actions(simulation, Goal(position, held[:, 1]))


def _action(space: object, draw: np.random.Generator) -> np.ndarray:
    """One action of a box or of a discrete space."""
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if low is not None and high is not None:
        return draw.uniform(low, high)
    count, start = int(space.n), int(space.start)  # type: ignore[attr-defined]
    return np.asarray(start + draw.integers(count))
