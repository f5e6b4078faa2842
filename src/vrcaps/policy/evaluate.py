"""Policy evaluation over seeds and episodes; failures are reported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.config.fields import Range, check_fields
from vrcaps.core.geometry import quaternion_from_matrix
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
    progress: Callable[[int, int], None] | None = None,
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
    if progress is not None:
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
            if progress is not None:
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
