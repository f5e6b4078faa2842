"""Episodes of a policy as a Minari data set, for offline reinforcement learning.

Minari: https://minari.farama.org. Data sets are in its folder, `MINARI_DATASETS_PATH` or
`~/.minari/datasets`.
"""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import __version__
from vrcaps.core.errors import InputError, import_extra, require
from vrcaps.env.vector_env import CapsuleVectorEnv

if TYPE_CHECKING:
    from vrcaps.env.settings import EnvSettings
    from vrcaps.policy.policy import Policy

_DATASET_ID = re.compile(r"([\w-]+/)*[\w-]+-v\d+", re.ASCII)
_MAX_EPISODES = 10**6


def record_minari(
    policy: Policy,
    settings: EnvSettings,
    dataset_id: str,
    *,
    episodes: int = 10,
    seed: int = 0,
    name: str = "",
) -> Any:
    """Run a policy and store its episodes as a Minari data set; returns the data set.

    Example:
        >>> data = record_minari(read_policy("next-best-view"), settings, "vrcaps/stomach-v0")
        >>> data.sample_episodes(1)[0].rewards

    Args:
        policy: Policy that acts.
        settings: Settings of the environment.
        dataset_id: Identifier with a version, such as ``vrcaps/stomach-v0``; it must be new.
        episodes: Number of episodes.
        seed: Seed of the first episode; the others follow.
        name: Name of the policy, stored as the algorithm.

    Raises:
        InputError: If the identifier is not valid or exists already, or the policy cannot act in
            the environment.
        MissingExtraError: If Minari is not installed.
    """
    minari = import_extra("minari", "robots")
    if not _DATASET_ID.fullmatch(dataset_id):
        raise InputError(
            f"dataset_id is {dataset_id!r}. Allowed: letters, digits, - and _ with a version, such "
            "as vrcaps/stomach-v0."
        )
    require(1 <= episodes <= _MAX_EPISODES, "episodes", episodes, f"1 to {_MAX_EPISODES}")
    if dataset_id in minari.list_local_datasets():
        raise InputError(f"The Minari data set {dataset_id} exists already. Give another version.")
    policy.requires.check(settings, name or type(policy).__name__)
    env = CapsuleVectorEnv(settings, 1, autoreset_mode="Disabled")
    buffers = [_episode(policy, env, seed + k) for k in range(episodes)]
    names = {key: list(texts) for key, texts in env.observation_names.items()}
    with warnings.catch_warnings():  # on an author, a link and a specification, which are unknown
        warnings.simplefilter("ignore", UserWarning)
        return minari.create_dataset_from_buffers(
            dataset_id=dataset_id,
            buffer=buffers,
            observation_space=env.single_observation_space,
            action_space=env.single_action_space,
            algorithm_name=name or type(policy).__name__,
            description=f"A capsule in {settings.task.kind} of vrcaps {__version__}. {names}",
            requirements=[f"vrcaps=={__version__}"],
            data_format="arrow",
            jpeg_encoding=False,
        )


def _episode(policy: Policy, env: CapsuleVectorEnv, seed: int) -> Any:
    """Run one episode to its end."""
    buffer = import_extra("minari.data_collector", "robots", package="minari").EpisodeBuffer
    observation, _ = env.reset(seed=seed)
    policy.reset(np.zeros(1, int), [seed])
    observations, rows = [_first(observation)], []
    is_over = False
    while not is_over:
        action = np.asarray(policy.act(observation, env))
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(_first(observation))
        rows.append((action[0], float(reward[0]), bool(terminated[0]), bool(truncated[0])))
        is_over = rows[-1][2] or rows[-1][3]
    actions, rewards, ends, cuts = zip(*rows, strict=True)
    dtype = env.single_action_space.dtype
    return buffer(
        seed=seed,
        observations={k: np.stack([o[k] for o in observations]) for k in observations[0]},
        actions=np.stack(actions).astype(dtype),
        rewards=list(rewards),
        terminations=list(ends),
        truncations=list(cuts),
    )


def _first(batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array[0].copy() for name, array in batch.items()}
