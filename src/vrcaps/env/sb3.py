"""Adapter of the vector environment to Stable-Baselines3's VecEnv."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from vrcaps.core.errors import MissingExtraError, require
from vrcaps.env.vector_env import CapsuleVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise MissingExtraError("stable-baselines3", "learn") from error

if TYPE_CHECKING:
    from vrcaps.env.settings import EnvSettings


class Sb3VecEnv(VecEnv):
    """The native vector environment as a VecEnv of Stable-Baselines3.

    A world is reset within the step that ends its episode. The `info` of a world has its metrics;
    at an episode's end also `terminal_observation` and `TimeLimit.truncated`.

    Example:
        >>> envs = Sb3VecEnv(EnvSettings(organs=("stomach",)), 16)
        >>> PPO("MultiInputPolicy", envs).learn(100_000)
    """

    def __init__(
        self,
        settings: EnvSettings | None = None,
        num_envs: int = 1,
        *,
        is_flat: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """Allocate buffers; worlds are created by `reset`.

        Args:
            settings: Settings of the environment.
            num_envs: Number of worlds.
            is_flat: Whether an observation is one vector, concatenated from its keys in the order
                of the settings; otherwise it is a dictionary.
            render_mode: `rgb_array` enables `render`; None disables it.

        Raises:
            InputError: If there is no world, or a mode is unknown.
        """
        self.envs = envs = CapsuleVectorEnv(
            settings, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, render_mode=render_mode
        )
        self.is_flat = is_flat
        space: Any = envs.single_observation_space
        self._actions = np.zeros(0)
        super().__init__(
            envs.num_envs,
            flat_space(space) if is_flat else space,
            envs.single_action_space,
        )

    def reset(self) -> Any:
        """Start an episode in every world, with the seeds of `seed` if it was called."""
        seeds = None if all(s is None for s in self._seeds) else self._seeds
        observations, infos = self.envs.reset(seed=seeds, options=self._options[0] or None)
        self.reset_infos = [_row(infos, k) for k in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return self._shaped(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take a step with the actions of `step_async`."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        over = terminated | truncated
        rows = [_row(infos, k) for k in range(self.num_envs)]
        for index in np.flatnonzero(over):
            last = {name: array[None] for name, array in infos["final_obs"][index].items()}
            rows[index] = _row(infos["final_info"], int(index))
            rows[index]["terminal_observation"] = (
                flat_observations(last, 1)[0] if self.is_flat else infos["final_obs"][index]
            )
            rows[index]["TimeLimit.truncated"] = bool(truncated[index] & ~terminated[index])
        return self._shaped(observations), rewards.astype(np.float32), over, rows

    def close(self) -> None:
        """Release the worlds."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the vector environment's attribute, once for each requested world."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all worlds, which share it."""
        self._require_all(indices)
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment once; the result is the same for each world."""
        answer = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [answer] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each world, since none is wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Render the first camera of each capsule."""
        return self.envs.render() or [None] * self.num_envs

    def _require_all(self, indices: Any) -> None:
        count = len(list(self._get_indices(indices)))
        require(count == self.num_envs, "indices", indices, "None; worlds share attributes")

    def _shaped(self, observations: dict[str, np.ndarray]) -> Any:
        return flat_observations(observations, self.num_envs) if self.is_flat else observations


def flat_observations(observations: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Flatten the observations of `count` worlds to rows of one array, key after key."""
    parts = [np.asarray(array, np.float32).reshape(count, -1) for array in observations.values()]
    return np.concatenate(parts, axis=1)


def flat_space(space: spaces.Dict) -> spaces.Box:
    """Space of one row of `flat_observations`."""
    boxes: list[Any] = list(space.values())
    low, high = (
        np.concatenate([np.broadcast_to(limit, box.shape).ravel() for limit, box in pairs])
        for pairs in ([(b.low, b) for b in boxes], [(b.high, b) for b in boxes])
    )
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _row(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """Infos of one world."""
    return {
        name: array[index]
        for name, array in infos.items()
        if not name.startswith(("_", "final_")) and infos[f"_{name}"][index]
    }
