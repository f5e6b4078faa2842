"""Multi-agent environment of several capsules in PettingZoo's parallel API."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils import seeding

from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.env.episode import Episode, EpisodeStep
from vrcaps.env.settings import EnvSettings

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise MissingExtraError("pettingzoo", "env") from error

if TYPE_CHECKING:
    from gymnasium import spaces


class CapsuleParallelEnv(ParallelEnv):
    """Independent capsules, each in its own organ, as agents of the parallel API.

    Agent ``capsule_k`` is in the k-th of the settings' organs. An agent whose episode ends is
    removed; the others continue.

    Example:
        >>> stomachs = tuple(OrganGenerated("stomach", seed=k) for k in range(3))
        >>> env = CapsuleParallelEnv(EnvSettings(organs=stomachs))
        >>> observations, infos = env.reset(seed=0)
        >>> actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        >>> observations, rewards, terminations, truncations, infos = env.step(actions)
    """

    metadata = {"name": "vrcaps", "render_modes": ["rgb_array"]}  # noqa: RUF012 (its name)

    def __init__(
        self,
        settings: EnvSettings | None = None,
        *,
        is_reward_shared: bool = True,
        render_mode: str | None = None,
    ) -> None:
        """Allocate buffers; worlds are created by `reset`.

        Args:
            settings: Settings of the environment.
            is_reward_shared: Whether each capsule receives the sum of all rewards, as in VR-Caps
                (Incetan et al. 2021: r = α Σ gains); otherwise each receives its own.
            render_mode: `rgb_array` enables `render`, which returns the images side by side.

        Raises:
            InputError: If the render mode is unknown.
        """
        settings = settings or EnvSettings()
        count = len(settings.organs)
        self.settings, self.render_mode = settings, render_mode
        self.is_reward_shared = is_reward_shared
        self.episode = Episode(settings, count, render_mode=render_mode)
        self.possible_agents = [f"capsule_{k}" for k in range(count)]
        self.agents: list[str] = []
        # Spaces contain random generators: one for each agent.
        self.action_spaces = {name: settings.actuation.space() for name in self.possible_agents}
        self.observation_spaces = dict.fromkeys(
            self.possible_agents, self.episode.observation_space
        )
        self._generators = [seeding.np_random(None)[0] for _ in range(count)]

    def observation_space(self, agent: str) -> spaces.Space:
        """Observation space of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Action space of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode of every capsule; agent k has the seed `seed` + k.

        Raises:
            InputError: If an organ cannot be created, or a capsule does not fit in it.
        """
        if seed is not None:
            count = len(self.possible_agents)
            self._generators = [seeding.np_random(seed + k)[0] for k in range(count)]
        for index, rng in enumerate(self._generators):
            self.episode.begin(index, rng, patient=index)
        self.agents = list(self.possible_agents)
        return self._of_each(self.episode.observe()), self._of_each(self.episode.measures())

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Advance all agents by one control period.

        Raises:
            InputError: If an agent has no action, or an action is not in the space.
        """
        missing = [agent for agent in self.agents if agent not in actions]
        if missing or not self.agents:
            given = ", ".join(actions) or "none"
            raise InputError(
                f"Actions are given for: {given}. Allowed: one for each of: "
                f"{', '.join(self.agents) or 'no agent is left; reset the environment'}."
            )
        names = self.possible_agents
        idle = next(iter(actions.values()))
        rows = np.stack([actions[n] if n in self.agents else idle for n in names])
        active = np.array([name in self.agents for name in names])
        step = self.episode.step(self.episode.check_actions(rows), active)
        return self._result(step)

    def _result(self, step: EpisodeStep) -> tuple:
        """Result of `step`; removes agents whose episode is over."""
        reward = step.reward
        if self.is_reward_shared:
            reward = np.full_like(reward, reward.sum())
        earned = {name: float(value) for name, value in self._of_each(reward).items()}
        ended, cut = (
            {name: bool(value) for name, value in self._of_each(flags).items()}
            for flags in (step.terminated, step.truncated)
        )
        observations = self._of_each(self.episode.observe())
        infos = self._of_each(step.measures)
        self.agents = [name for name in self.agents if not (ended[name] or cut[name])]
        return observations, earned, ended, cut, infos

    def _of_each(self, batch: Any) -> dict[str, Any]:
        """Split an array or a dictionary of arrays by agent."""
        rows = {}
        for index, name in enumerate(self.possible_agents):
            if name not in self.agents:
                continue
            if isinstance(batch, dict):
                rows[name] = {key: _copy(array[index]) for key, array in batch.items()}
            else:
                rows[name] = batch[index]
        return rows

    def render(self) -> np.ndarray | None:
        """Render the first camera of each capsule, side by side [h w 3].

        Raises:
            InputError: If the environment has not been reset.
        """
        if self.render_mode is None:
            return None
        return np.concatenate(self.episode.images(), axis=1)

    def close(self) -> None:
        """Release the worlds."""
        count = len(self.possible_agents)
        self.episode = Episode(self.settings, count, render_mode=self.render_mode)
        self.agents = []


def _copy(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value
