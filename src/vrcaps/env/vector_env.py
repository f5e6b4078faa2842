"""Native vector environment: many worlds stepped in one call of the core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import plain_value
from vrcaps.env.episode import Episode, EpisodeStep
from vrcaps.env.parts import EnvView
from vrcaps.env.settings import EnvSettings
from vrcaps.env.simulation import EnvSnapshot, restore_snapshot, take_snapshot


class CapsuleVectorEnv(gymnasium.vector.VectorEnv):
    """Independent capsules, each in its own world, as one Gymnasium vector environment.

    With the seed s, world k gives the same bytes as `CapsuleEnv` with the seed s + k.

    Example:
        >>> envs = gymnasium.make_vec("vrcaps.env:Coverage-v0", num_envs=16, organs=("stomach",))
        >>> observations, infos = envs.reset(seed=0)
        >>> observations, rewards, terminated, truncated, infos = envs.step(actions)
    """

    def __init__(
        self,
        settings: EnvSettings | None = None,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        """Allocate buffers; worlds are created by `reset`.

        Args:
            settings: Settings of the environment.
            num_envs: Number of worlds.
            autoreset_mode: Behavior after an episode's end: `NextStep`, `SameStep` or `Disabled`,
                see `gymnasium.vector.AutoresetMode`.
            render_mode: `rgb_array` enables `render`, with an image of each world.

        Raises:
            InputError: If there is no world, or a mode is unknown.
        """
        require(num_envs >= 1, "num_envs", num_envs, "1 or more")
        self.settings = settings or EnvSettings()
        self.num_envs = num_envs
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = {"render_modes": ["rgb_array"], "autoreset_mode": self.autoreset_mode}
        self.render_mode = render_mode
        self.episode = Episode(self.settings, num_envs, render_mode=render_mode)
        self.single_observation_space = self.episode.observation_space
        self.single_action_space = self.episode.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._is_over = np.ones(num_envs, bool)
        self._was_reset = False

    @property
    def observation_names(self) -> dict[str, tuple[str, ...]]:
        """Names and units of the values of each observation, see `Episode.observation_names`."""
        return self.episode.observation_names

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the values of an action; their values at an action of 1 are in brackets."""
        return self.settings.actuation.names

    @property
    def view(self) -> EnvView:
        """Read-only view of the worlds, which is not available to a real capsule."""
        return self.episode.view

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode in every world, or in those of `options={"reset_mask": …}`.

        Args:
            seed: One seed for each world, or one to which each world's index is added.
            options: `reset_mask` has a boolean for each world.

        Raises:
            InputError: If the mask does not fit, or an organ cannot be created.
        """
        mask = np.ones(self.num_envs, bool)
        if options and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"], bool)
            require(mask.shape == (self.num_envs,), "reset_mask", mask, "one value per world")
        seed = plain_value(seed)
        seeds = [seed + k for k in range(self.num_envs)] if isinstance(seed, int) else seed
        for index, value in enumerate(seeds or ()):
            if value is not None and mask[index]:
                self._generators[index] = seeding.np_random(plain_value(value))[0]
        if seeds is not None and seeds[0] is not None:
            self._np_random, self._np_random_seed = seeding.np_random(int(seeds[0]))
        require(self._was_reset or bool(mask.all()), "reset_mask", mask, "all at the first reset")
        self._begin(np.flatnonzero(mask))
        self._was_reset = True
        return self.episode.observe(), self._masked(self.episode.measures(), mask)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every world by one control period; see `gymnasium.vector.VectorEnv.step`.

        Raises:
            InputError: If there was no reset, or an action is not in the space.
        """
        require(self._was_reset, "The environment's state", "none", "a reset before the first step")
        actions = self.episode.check_actions(actions)
        resets = np.flatnonzero(self._is_over)
        if len(resets) and self.autoreset_mode is AutoresetMode.DISABLED:
            raise InputError(
                f"Worlds {', '.join(map(str, resets))} are over. Reset them with "
                "options={'reset_mask': …}."
            )
        active = ~self._is_over
        step = self.episode.step(actions, active)
        infos = self._masked(step.measures, active)
        if len(resets):
            self._begin(resets)
        self._is_over = active & (step.terminated | step.truncated)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._is_over.any():
            return self._reset_in_step(step, infos)
        return self.episode.observe(), step.reward, step.terminated, step.truncated, infos

    def _reset_in_step(self, step: EpisodeStep, infos: dict[str, Any]) -> tuple:
        """Reset the worlds that are over within the step, and return its result."""
        over, last = self._is_over.copy(), self.episode.observe()
        final = np.full(self.num_envs, None, object)
        for index in np.flatnonzero(over):
            final[index] = {name: array[index].copy() for name, array in last.items()}
        infos |= {
            "final_obs": final,
            "_final_obs": over.copy(),
            "final_info": self._masked(step.measures, over),
            "_final_info": over.copy(),
        }
        self._begin(np.flatnonzero(over))
        return self.episode.observe(), step.reward, step.terminated, step.truncated, infos

    def _begin(self, indices: np.ndarray) -> None:
        for index in indices:
            self.episode.begin(int(index), self._generators[index])
        self._is_over[indices] = False

    @staticmethod
    def _masked(measures: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
        """Add masks that state which worlds the metrics belong to."""
        marks = {f"_{name}": mask.copy() for name in measures}
        return {**measures, **marks}

    def snapshot(self, index: int | None = None) -> EnvSnapshot:
        """Return the full state of one world or of all, see `CapsuleEnv.snapshot`.

        Raises:
            InputError: If there was no reset, or there is no such world.
        """
        require(self._was_reset, "The environment's state", "none", "a reset before a snapshot")
        return take_snapshot(
            self.episode.simulation, self._chosen(index), self._generators, self._is_over
        )

    def restore(self, snapshot: EnvSnapshot, index: int | None = None) -> dict[str, np.ndarray]:
        """Restore one world or all from a snapshot, which may be of another environment.

        Returns:
            The observations of all worlds in the restored state.

        Raises:
            InputError: If it is of other settings, or of another number of worlds; or if a single
                world is restored before the first reset.
        """
        given = "one" if index is not None else "all"
        is_allowed = self._was_reset or index is None
        require(is_allowed, "Worlds to restore", given, "all before the first reset")
        indices = self._chosen(index)
        restore_snapshot(self.episode.simulation, snapshot, indices, self._generators)
        self._is_over[indices] = [world.is_over for world in snapshot.worlds]
        self._was_reset = True
        return self.episode.observe()

    def _chosen(self, index: int | None) -> list[int]:
        """Indices of one world or of all."""
        if index is None:
            return list(range(self.num_envs))
        require(0 <= index < self.num_envs, "index", index, f"0 to {self.num_envs - 1}")
        return [index]

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Render the first camera of each capsule; None without a render mode.

        Raises:
            InputError: If there was no reset.
        """
        if self.render_mode is None:
            return None
        require(self._was_reset, "The environment's state", "none", "a reset before an image")
        return tuple(self.episode.images())

    def close_extras(self, **kwargs: Any) -> None:
        """Release the worlds."""
        self.episode = Episode(self.settings, self.num_envs, render_mode=self.render_mode)
        self._was_reset = False


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    known = {m.value.lower(): m for m in AutoresetMode}
    name = (mode.value if isinstance(mode, AutoresetMode) else str(mode)).lower().replace("_", "")
    require(name in known, "autoreset_mode", mode, ", ".join(m.value for m in AutoresetMode))
    return known[name]


def with_time_limit(settings: EnvSettings, max_episode_steps: int | None) -> EnvSettings:
    """Limit the number of steps of an episode; None leaves the settings unchanged."""
    if max_episode_steps is None:
        return settings
    return replace(settings, episode_time=max_episode_steps * settings.control_period)
