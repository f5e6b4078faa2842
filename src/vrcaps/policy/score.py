"""Score of a policy during training: the same few episodes, in parallel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core import rng
from vrcaps.env.vector_env import CapsuleVectorEnv

if TYPE_CHECKING:
    from vrcaps.env.settings import EnvSettings
    from vrcaps.policy.policy import Policy


class Score:
    """Mean metrics of any policy over the same episodes."""

    def __init__(self, settings: EnvSettings, num_episodes: int, seed: int) -> None:
        """Create the environment; worlds are created on the first call.

        Args:
            settings: Settings of the environment.
            num_episodes: Number of episodes.
            seed: Seed of the episodes; training uses none of them.
        """
        draw = rng.stream(seed, "policy/score")
        self._envs = CapsuleVectorEnv(settings, num_episodes)
        self._seeds = draw.integers(2**31, size=num_episodes).tolist()

    def __call__(self, policy: Policy) -> dict[str, float]:
        """Return the mean sum of rewards, and the mean of each metric at the end."""
        count = self._envs.num_envs
        observations, infos = self._envs.reset(seed=self._seeds)
        policy.reset(np.arange(count), self._seeds)
        total, is_over = np.zeros(count), np.zeros(count, bool)
        last = {name: infos[name].copy() for name in _numbers(infos)}
        while not is_over.all():
            actions = policy.act(observations, self._envs)
            observations, rewards, terminated, truncated, infos = self._envs.step(actions)
            total += np.where(is_over, 0.0, rewards)
            for name, values in last.items():
                values[~is_over] = infos[name][~is_over]
            is_over |= terminated | truncated
        return {"reward": float(total.mean()), **{k: float(v.mean()) for k, v in last.items()}}

    def close(self) -> None:
        """Close the worlds."""
        self._envs.close()


def _numbers(infos: dict) -> list[str]:
    """Names of the numeric and boolean metrics."""
    return [k for k, v in infos.items() if not k.startswith("_") and v.dtype.kind in "fb"]
