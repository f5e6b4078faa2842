"""Registration of the environments with Gymnasium, and their keyword arguments."""

from __future__ import annotations

from typing import Any

from vrcaps.env.settings import EnvSettings, env_settings

ENVIRONMENTS = {"Coverage-v0": "coverage", "Navigate-v0": "navigate", "Inspect-v0": "inspect"}
"""Tasks by the name of their environment."""


def register(gymnasium: Any) -> None:
    """Register an environment for each task."""
    for name, task in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="vrcaps.env.registration:make_env",
                vector_entry_point="vrcaps.env.registration:make_vector_env",
                kwargs={"task": task},
            )


def make_env(render_mode: str | None = None, **keywords: Any) -> Any:
    """Create the environment of one capsule from keyword arguments."""
    from vrcaps.env.env import CapsuleEnv

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
