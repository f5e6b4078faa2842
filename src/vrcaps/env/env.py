"""Gymnasium environment of one capsule, and the registration of all environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from vrcaps.core.errors import require
from vrcaps.env.episode import Episode
from vrcaps.env.parts import EnvView
from vrcaps.env.settings import EnvSettings, env_settings
from vrcaps.env.simulation import EnvSnapshot, restore_snapshot, take_snapshot

ENVIRONMENTS = {"Coverage-v0": "coverage", "Navigate-v0": "navigate", "Inspect-v0": "inspect"}
"""Tasks by the name of their environment."""


def register() -> None:
    """Register an environment for each task."""
    for name, task in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="vrcaps.env.env:make_env",
                vector_entry_point="vrcaps.env.env:make_vector_env",
                kwargs={"task": task},
            )


def make_env(render_mode: str | None = None, **keywords: Any) -> Any:
    """Create the environment of one capsule from keyword arguments."""
    return CapsuleEnv(_settings(keywords), render_mode=render_mode)


def make_vector_env(
    num_envs: int = 1,
    max_episode_steps: int | None = None,
    render_mode: str | None = None,
    autoreset_mode: Any = "NextStep",
    **keywords: Any,
) -> Any:
    """Create the vector environment from keyword arguments."""
    from vrcaps.env.vector_env import CapsuleVectorEnv, with_time_limit

    settings = with_time_limit(_settings(keywords), max_episode_steps)
    return CapsuleVectorEnv(
        settings, num_envs, autoreset_mode=autoreset_mode, render_mode=render_mode
    )


def _settings(keywords: dict[str, Any]) -> EnvSettings:
    return keywords.pop("settings", None) or env_settings(**keywords)


class CapsuleEnv(gymnasium.Env):
    """A capsule in an organ as a Gymnasium environment.

    Example:
        >>> env = gymnasium.make("vrcaps.env:Coverage-v0", organs=("stomach",))
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 6}  # noqa: RUF012 (Gymnasium's name)

    def __init__(
        self, settings: EnvSettings | None = None, *, render_mode: str | None = None
    ) -> None:
        """Allocate buffers; the world is created by `reset`.

        Raises:
            InputError: If the render mode is unknown.
        """
        self.settings, self.render_mode = settings or EnvSettings(), render_mode
        self.episode = Episode(self.settings, 1, render_mode=render_mode)
        self.action_space = self.episode.action_space
        self.observation_space = self.episode.observation_space

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
        """Read-only view of the world, which is not available to a real capsule."""
        return self.episode.view

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode.

        Raises:
            InputError: If the organ cannot be created, or the capsule does not fit in it.
        """
        super().reset(seed=seed)
        self.episode.begin(0, self.np_random)
        return self._first(self.episode.observe()), self._plain(self.episode.measures())

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Advance by one control period.

        Raises:
            InputError: If there was no reset, or the action is not in the space.
        """
        self._check_reset()
        actions = self.episode.check_actions(np.asarray(action)[None])
        step = self.episode.step(actions, np.ones(1, bool))
        return (
            self._first(self.episode.observe()),
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            self._plain(step.measures),
        )

    def render(self) -> np.ndarray | None:
        """Render the view of the capsule's first camera [h w 3]; None without a render mode.

        Raises:
            InputError: If there was no reset.
        """
        if self.render_mode is None:
            return None
        self._check_reset()
        return self.episode.images()[0]

    def snapshot(self) -> EnvSnapshot:
        """Return the full state, for `restore` here or in another environment of the same settings.

        Raises:
            InputError: If there was no reset.
        """
        self._check_reset()
        return take_snapshot(self.episode.simulation, [0], [self.np_random], np.zeros(1, bool))

    def restore(self, snapshot: EnvSnapshot) -> dict[str, np.ndarray]:
        """Restore a snapshot; the same actions then give the same bytes.

        Returns:
            The observation in the restored state.

        Raises:
            InputError: If it is of other settings.
        """
        restore_snapshot(self.episode.simulation, snapshot, [0], [self.np_random])
        return self._first(self.episode.observe())

    def _check_reset(self) -> None:
        worlds = self.view.batch.worlds
        require(bool(worlds), "The world", "none", "a reset before the first step")

    @staticmethod
    def _first(batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name: array[0].copy() for name, array in batch.items()}

    @staticmethod
    def _plain(batch: dict[str, np.ndarray]) -> dict[str, Any]:
        return {name: array[0] for name, array in batch.items()}
