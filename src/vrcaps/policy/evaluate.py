"""Runs of policies over seeds and episodes: evaluation, and Minari data sets."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps import __version__
from vrcaps.core.errors import InputError, StorageError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import atomic_folder
from vrcaps.core.geometry import quaternion_from_matrix
from vrcaps.core.names import require_dataset_id
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.evaluation import (
    EpisodeCurves,
    Evaluation,
    episode_measures,
    success_measures,
)

if TYPE_CHECKING:
    from vrcaps.env.episode import EpisodeStep
    from vrcaps.env.parts import EnvView
    from vrcaps.env.settings import EnvSettings
    from vrcaps.policy.policy import Policy

_SEEDS_APART = 1000
"""Seed stride: episode e of seed s uses the seed 1000 s + e."""

_MAX_EPISODES = 10**6

_DONE = "done"
"""End of an episode whose task is completed."""


@dataclass(frozen=True)
class Plan:
    """Size of an evaluation.

    Attributes:
        seeds: Number of seeds 0, 1, …; seed s uses organ s modulo the number of organs.
        episodes: Number of episodes per seed, each from another start.
        worlds: Number of parallel episodes.
    """

    seeds: Annotated[int, Range(min=1)] = 80
    episodes: Annotated[int, Range(min=1, max=_SEEDS_APART)] = 5
    worlds: Annotated[int, Range(min=1)] = 20

    def __post_init__(self) -> None:
        check_fields(self)

    def trials(self, organ: int, num_organs: int) -> list[tuple[int, int]]:
        """Seeds and episode indices of all trials in one organ."""
        seeds = range(organ, self.seeds, num_organs)
        return [(seed, episode) for seed in seeds for episode in range(self.episodes)]


def evaluate(
    policy: Policy,
    settings: EnvSettings,
    plan: Plan,
    evaluation: Evaluation,
    progress: ProgressReport = no_report,
) -> None:
    """Run all episodes that are missing from the folder.

    Args:
        policy: Policy to evaluate.
        settings: Settings of the environment, with all organs.
        plan: Number of seeds and episodes.
        evaluation: Output folder.
        progress: Called with the number of completed episodes and the total.
    """
    total, num_organs = plan.seeds * plan.episodes, len(settings.organs)
    progress(len(evaluation.done), total)
    for number, organ in enumerate(settings.organs):
        done = evaluation.done
        trials = [t for t in plan.trials(number, num_organs) if t not in done]
        if not trials:
            continue
        envs = CapsuleVectorEnv(
            replace(settings, organs=(organ,)),
            min(plan.worlds, len(trials)),
            autoreset_mode="Disabled",
        )
        for first in range(0, len(trials), envs.num_envs):
            some = trials[first : first + envs.num_envs]
            evaluation.add(*_run(policy, envs, some))
            progress(len(evaluation.done), total)


def organ_name(organ: Any) -> str:
    """Name of an organ of an environment's settings: its generator and seed, or its file."""
    if hasattr(organ, "seed"):
        return f"{organ.name}:{organ.seed}"
    return str(getattr(organ, "path", None) or organ.name)


def _run(
    policy: Policy, envs: CapsuleVectorEnv, trials: Sequence[tuple[int, int]]
) -> tuple[list[dict[str, Any]], list[EpisodeCurves]]:
    """Run episodes in parallel; worlds without one are not stepped."""
    count, view = len(trials), envs.view
    seeds = [_SEEDS_APART * seed + episode for seed, episode in trials]
    seeds += seeds[-1:] * (envs.num_envs - count)
    observations, _ = envs.reset(seed=seeds)
    policy.reset(np.arange(envs.num_envs), seeds)
    active = np.arange(envs.num_envs) < count
    samples, sampled, ends = [_sample(view)], [active.copy()], [""] * envs.num_envs
    while active.any():
        actions = envs.episode.check_actions(policy.act(observations, envs))
        step = envs.episode.step(actions, active)
        samples.append(_sample(view))
        sampled.append(active.copy())
        for index in np.flatnonzero(active & (step.terminated | step.truncated)):
            ends[index] = _end(step, int(index))
            active[index] = False
        observations = envs.episode.observe()
    whole, were_active = np.stack(samples), np.stack(sampled)
    progress = envs.settings.task.progress(view)
    rows, curves = [], []
    for index, (seed, episode) in enumerate(trials):
        curve = _curves(whole[were_active[:, index], index])
        row = {
            "seed": seed,
            "episode": episode,
            "organ": organ_name(envs.settings.organs[0]),
            "end": ends[index],
            "wall_escapes": int(ends[index] == "outside the wall"),
        }
        is_success, reached = ends[index] == _DONE, float(progress[index])
        row |= success_measures(curve, reached, is_success=is_success)
        row |= episode_measures(curve, envs.settings.episode_time)
        rows.append(row)
        curves.append(curve)
    return rows, curves


def _sample(view: EnvView) -> np.ndarray:
    """Values of all curves, a row for each world."""
    T = view.T_world_capsule
    return np.column_stack(
        [
            view.time,
            view.coverage.fraction,
            view.arc_length,
            view.normal_force_total,
            T[:, :3, 3],
            quaternion_from_matrix(T[:, :3, :3]),
        ]
    )


def _curves(rows: np.ndarray) -> EpisodeCurves:
    """Curves of one world from its samples."""
    return EpisodeCurves(rows[:, 0], rows[:, 1:4], rows[:, 4], rows[:, 5], rows[:, 6:])


def _end(step: EpisodeStep, index: int) -> str:
    """Reason of an episode's end."""
    measures = step.measures
    if measures["is_outside"][index]:
        return "outside the wall"
    if measures["failure"][index]:
        return f"failed: {measures['failure'][index]}"
    if step.terminated[index]:
        return _DONE
    names = {"is_too_fast": "too fast", "is_stuck": "stuck"}
    return next((said for name, said in names.items() if measures[name][index]), "time")


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

    It is in Minari's folder, `MINARI_DATASETS_PATH` or `~/.minari/datasets`; its metadata has the
    names and units of observations and actions (https://minari.farama.org).

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
        StorageError: If Minari's folder cannot be written.
        MissingExtraError: If Minari is not installed.
    """
    minari = import_extra("minari", "robots")
    require_dataset_id(dataset_id)
    is_count = isinstance(episodes, int) and 1 <= episodes <= _MAX_EPISODES
    require(is_count, "episodes", episodes, f"1 to {_MAX_EPISODES}")
    require(isinstance(seed, int) and seed >= 0, "seed", seed, "a whole number from 0")
    name, task = name or type(policy).__name__, settings.task.kind
    policy.requires.check(settings, name)
    metadata = {
        "dataset_id": dataset_id,
        "algorithm_name": name,
        "description": f"A capsule in the task {task} of vrcaps {__version__}.",
        "requirements": [f"vrcaps=={__version__}"],
        "minari_version": minari.__version__,
        "reward": f"that of the task {task}",
    }
    with atomic_folder(_new_place(dataset_id)) as partial:
        env = CapsuleVectorEnv(settings, 1, autoreset_mode="Disabled")
        storage = _new_storage(partial / "data", env)
        storage.update_metadata(metadata)
        for k in range(episodes):
            storage.update_episodes([_episode(policy, env, seed + k)])
    return minari.load_dataset(dataset_id)


def _new_storage(path: Path, env: CapsuleVectorEnv) -> Any:
    """Empty storage of Minari for an environment, with the names of its values."""
    storages = import_extra("minari.dataset.minari_storage", "robots", package="minari")
    spaces = (env.single_observation_space, env.single_action_space)
    path.mkdir()
    with warnings.catch_warnings():  # on a specification, which is unknown
        warnings.simplefilter("ignore", UserWarning)
        storage = storages.MinariStorage.new(
            path, *spaces, data_format="arrow", jpeg_encoding=False
        )
    names = {key: list(texts) for key, texts in env.observation_names.items()}
    storage.update_metadata({"observation_names": names, "action_names": list(env.action_names)})
    return storage


def _new_place(dataset_id: str) -> Path:
    """Folder of a new data set, in an existing folder.

    Raises:
        InputError: If it exists already, or lies in another data set.
        StorageError: If Minari's folder cannot be written.
    """
    roots = import_extra("minari.storage.datasets_root_dir", "robots", package="minari")
    try:
        root = roots.get_dataset_path()
        path = root / dataset_id
        if os.path.lexists(path):
            raise InputError(
                f"The Minari data set {dataset_id} exists already. Give another version."
            )
        for above in list(path.relative_to(root).parents)[:-1]:
            if (root / above / "data").exists():
                raise InputError(f"{dataset_id} lies in the data set {above}. Give another name.")
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"Cannot write Minari's folder: {error}. Set MINARI_DATASETS_PATH to a writable folder."
        ) from error
    return path


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
