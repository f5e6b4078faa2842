"""Training of a policy in a folder: settings and presets, checkpoints, progress, policies."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.config.convert import to_plain
from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import file_sha256, read_arrays, write_arrays, write_csv
from vrcaps.env.actuation import MagnetActuation, Wrench
from vrcaps.env.exploration import ExplorationObservation
from vrcaps.env.landmarks import LandmarksObservation
from vrcaps.env.observations import StateObservation
from vrcaps.env.patients import check_names
from vrcaps.env.randomization import Start
from vrcaps.env.rewards import ForcePenalty, LogGain, PaperGain
from vrcaps.env.settings import EnvSettings, plain_environment
from vrcaps.env.tasks import CoverageTask
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.mlp_policy import read_mlp_policy, write_mlp_policy
from vrcaps.policy.ppo import Ppo, PpoSettings, imitate, require_learner, taught_settings
from vrcaps.training import PROGRESS, Progress, begin_training, exact_torch, restoring, run_training

if TYPE_CHECKING:
    from vrcaps.policy.mlp_policy import MlpPolicy
    from vrcaps.policy.policy import Policy


CHECKPOINT = "checkpoint.npz"
POLICY, BEST = "policy.npz", "best.npz"
_PACKAGES = ("gymnasium", "numpy", "scipy", "stable-baselines3", "torch")
"""Packages that a training's bytes depend on."""


@dataclass(frozen=True)
class TrainingSettings:
    """All settings that determine a training's result.

    Attributes:
        env: Settings of the environment.
        learner: Hyperparameters of PPO.
        seed: Random seed.
    """

    env: EnvSettings = field(default_factory=EnvSettings)
    learner: PpoSettings = field(default_factory=PpoSettings)
    seed: Annotated[int, Range(0, rng.MAX_SEED)] = 0

    def __post_init__(self) -> None:
        check_fields(self)


def train(
    settings: TrainingSettings,
    out: Path,
    *,
    threads: int = 1,
    is_forced: bool = False,
    start: Path | None = None,
    tensorboard: Path | None = None,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Progress:
    """Train a policy, or resume an interrupted training byte for byte.

    A completed training continues if `num_actions` has increased; an annealed learning rate then
    decreases until the new end. `out` then holds `policy.npz`, the last policy, `best.npz`, the one
    with the best evaluation, `settings.json`, `progress.csv` with a row for each round, and
    `checkpoint.npz` to resume from.

    Args:
        settings: Settings of the training.
        out: Folder: new, empty, or of the same training.
        threads: Number of PyTorch threads; one is fastest for a small network.
        is_forced: Resume even if vrcaps or a package has changed since the start of the training.
        start: Folder of a training or file of a policy to start from, see `warm_start`.
        tensorboard: Folder for TensorBoard's files; None writes none.
        report: Called after each round.

    Raises:
        InputError: If the folder contains other files, or a training with other settings or
            versions, the start does not fit the settings, or the teacher does not act on
            observations.
        UnknownNameError: If an organ or the capsule is unknown.
        MissingExtraError: If a package of the learner is not installed.
    """
    check_names(settings.env.organs, settings.env.capsule)
    _require_teacher(settings.env, settings.learner.teacher)
    stated = plain_settings(settings)
    if start is not None:
        stated["start"] = file_sha256(start_file(start))
    require_learner()
    start_training = partial(
        begin_training,
        *(out, stated, _PACKAGES),
        is_forced=is_forced,
        growing=("learner.num_actions",),
    )
    if start is None:
        start_training()
    with exact_torch(threads):
        learner = Ppo(settings.env, settings.learner, settings.seed)
        if start is not None:
            warm_start(learner, start_file(start))  # one that does not fit leaves no folder
            start_training()
        if tensorboard is not None:
            learner.log_to(tensorboard)
        progress = run_training(_Run(settings, out, learner), report)
        learner.close()
    return progress


def _require_teacher(env: EnvSettings, name: str) -> None:
    """Check that a learner's teacher fits, and acts by observations, so that it can be imitated."""
    if not name:
        return
    teacher = read_policy(name)
    if not teacher.requires.observations:
        raise InputError(
            f"learner.teacher is {name!r}, which acts by the true state of the simulation or at "
            "random, not by observations. Allowed: explorer, or a trained policy's file."
        )
    taught_settings(env, teacher, name)


class _Run:
    """Policy in training, and its progress."""

    def __init__(self, settings: TrainingSettings, out: Path, learner: Ppo) -> None:
        self.settings, self.out, self.learner = settings, out, learner
        self.score = Score(settings.env, settings.learner.evaluation_episodes, settings.seed)
        self.progress = _read_checkpoint(out, learner)
        self._imitation: dict[str, float] = {}
        if self.progress.step == 0 and settings.learner.teacher:
            self._imitate()

    def _imitate(self) -> None:
        """Imitate the teacher; the result is the best policy until a round surpasses it."""
        teacher = read_policy(self.settings.learner.teacher)
        self._imitation = imitate(self.learner, teacher)
        policy = self.learner.policy()
        scores = self.score(policy)
        self._imitation |= {f"imitation_{name}": value for name, value in scores.items()}
        self._write_policy(BEST, policy, 0)
        self.progress = replace(self.progress, best=scores["reward"])

    def advance(self) -> None:
        """Run one round, the evaluation that is due after it, and write the checkpoint."""
        settings, learner, progress = self.settings, self.learner, self.progress
        index, start = progress.step, time.perf_counter()
        done = index + 1
        row = {"round": float(done), "actions": float(done) * learner.actions_per_round}
        row |= self._imitation | learner.run_round(index)
        self._imitation = dict.fromkeys(self._imitation, np.nan)
        policy, best, every = learner.policy(), progress.best, settings.learner.evaluate_every
        is_last = done == progress.total
        if every and (done % every == 0 or is_last):
            scores = self.score(policy)
            row |= {f"evaluation_{name}": value for name, value in scores.items()}
            if best is None or scores["reward"] > best:
                best = scores["reward"]
                self._write_policy(BEST, policy, done)
        if is_last:
            self._write_policy(POLICY, policy, done)
            if not every:
                self._write_policy(BEST, policy, done)
        row["seconds"] = time.perf_counter() - start
        self.progress = replace(progress, step=done, rows=(*progress.rows, row), best=best)
        _write_checkpoint(self.out, learner, self.progress)

    def _write_policy(self, name: str, policy: MlpPolicy, done: int) -> None:
        write_mlp_policy(self.out / name, policy, {"rounds": done, "seed": self.settings.seed})


def plain_settings(settings: TrainingSettings) -> dict[str, Any]:
    """Settings as plain values, see `plain_environment`."""
    learner = to_plain(settings.learner, PpoSettings)
    return {"env": plain_environment(settings.env), "learner": learner, "seed": settings.seed}


def _read_checkpoint(out: Path, learner: Ppo) -> Progress:
    """Read the progress of a training and restore the learner's state."""
    path = out / CHECKPOINT
    if not path.is_file():
        return Progress(0, learner.num_rounds)
    with restoring(path):
        arrays = read_arrays(path)
        stated = json.loads(str(arrays.pop("progress")))
        learner.load(arrays)
        rows, best = tuple(stated["rows"]), stated["best"]
        return Progress(stated["num_rounds"], learner.num_rounds, rows, best)


def _write_checkpoint(out: Path, learner: Ppo, progress: Progress) -> None:
    stated = {"num_rounds": progress.step, "rows": progress.rows, "best": progress.best}
    write_csv(out / PROGRESS, progress.rows)
    write_arrays(out / CHECKPOINT, {**learner.state(), "progress": np.array(json.dumps(stated))})


def start_file(start: Path) -> Path:
    """Resolve a start to a file: the checkpoint of a training's folder, or a policy's file.

    Raises:
        InputError: If there is none.
    """
    path = start / CHECKPOINT if start.is_dir() else start
    if not path.is_file():
        raise InputError(
            f"{start} contains no {CHECKPOINT}. Give the folder of a training, or a policy's file."
        )
    return path


def warm_start(learner: Ppo, path: Path) -> None:
    """Initialize a learner from a checkpoint or a policy's file.

    A checkpoint holds the policy, its value function, Adam's moments and the normalizer; the file
    of a policy holds the policy and the normalizer.

    Args:
        learner: Untrained learner.
        path: File from `start_file`.

    Raises:
        InputError: If the file is damaged, or of other observations, actions or layers.
    """
    try:
        if path.name == CHECKPOINT:
            arrays = read_arrays(path)
            arrays.pop("progress")
            learner.load(arrays)
        else:
            _load_policy(learner, path)
    except (OSError, ValueError, LookupError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"Cannot start from {path}: {str(error).splitlines()[0]} Allowed: a training of the "
            "same observations, actions and layers."
        ) from error


def _load_policy(learner: Ppo, path: Path) -> None:
    import torch

    policy, net = read_mlp_policy(path), learner.model.policy
    chain: list[Any] = [*net.mlp_extractor.policy_net, net.action_net]  # type: ignore[attr-defined]
    layers = [module for module in chain if hasattr(module, "weight")]
    given = [weight.shape for weight, _ in policy.layers]
    own = [tuple(module.weight.shape) for module in layers]
    if given != own:
        raise InputError(f"{path} has layers of {given}. Allowed: {own}, as the settings have.")
    with torch.no_grad():
        for module, (weight, bias) in zip(layers, policy.layers, strict=True):
            module.weight.copy_(torch.from_numpy(weight))
            module.bias.copy_(torch.from_numpy(bias))
    if learner.settings.is_normalized:
        spread: Any = learner.envs.obs_rms
        spread.mean, spread.var = policy.normalizer.mean.copy(), policy.normalizer.variance.copy()
        spread.count = float(learner.actions_per_round)  # as if one round had been seen


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


def paper() -> TrainingSettings:
    """Training for coverage as in the paper (Incetan et al. 2021).

    It states the reward, the discrete actions, 7,500 steps of 1/30 s per episode, three stomachs,
    3 layers of 256, minibatches of 64, the learning rate and 500,000 steps. Epochs, γ, λ, the
    clipping and the entropy weight are the defaults of ML-Agents, which it used.
    """
    env = EnvSettings(
        task=CoverageTask(level="frustum"),
        actuation=Wrench("discrete", is_weightless=True),
        observations=(StateObservation(),),
        rewards=(PaperGain(level="frustum"),),
        organs=("stomach:0-2",),
        episode_time=250.0,
        stuck_time=250.0,
    )
    learner = PpoSettings(
        num_envs=3,
        num_actions=500_000,
        updates=1,
        hidden=(256, 256, 256),
        batch=64,
        epochs=3,
        entropy=5e-3,
        evaluate_every=10,
    )
    return TrainingSettings(env, learner)


def default() -> TrainingSettings:
    """Default preset: visible coverage, with observations that are the same for every organ.

    Observations and actions are in the capsule's frame, so that a policy generalizes over poses.
    In free motion, the capsule reaches 55 mm/s and about 2 rad/s. The last percent is rewarded as
    well, and no episode ends early, so that the policy seeks full coverage.
    """
    env = EnvSettings(
        task=CoverageTask(target=1.0),
        rewards=(LogGain(),),
        actuation=Wrench(force=5e-3, torque=1e-5, is_weightless=True, frame="capsule"),
        observations=(LandmarksObservation(),),
        organs=("stomach:0-15",),
        start=Start(settle=0.0),
        episode_time=50.0,
    )
    return TrainingSettings(env, PpoSettings(num_actions=3_000_000, entropy=0.0, initial_std=0.5))


def ci() -> TrainingSettings:
    """Smoke-test preset: runs in seconds, with too few actions to improve."""
    ours = default()
    env = replace(ours.env, organs=("stomach:0",), episode_time=1.0, num_points=256)
    learner = replace(
        ours.learner, num_envs=2, num_actions=36, updates=1, hidden=(16,), evaluation_episodes=2
    )
    return TrainingSettings(env, learner)


def device() -> TrainingSettings:
    """Preset with the observations of a device, a magnet and gravity.

    The explorer is imitated first. The reward measures the true coverage, which only the training
    knows.
    """
    env = EnvSettings(
        task=CoverageTask(target=1.0),
        rewards=(LogGain(), ForcePenalty(0.02)),
        actuation=MagnetActuation(),
        observations=(StateObservation(pose="located"), ExplorationObservation()),
        organs=("stomach:0-15",),
        dynamics="physics",
        substep=1e-3,
        control_period=0.1,
        stuck_time=60.0,
    )
    learner = PpoSettings(
        num_envs=16, num_actions=300_000, entropy=0.0, initial_std=0.2, teacher="explorer"
    )
    return TrainingSettings(env, learner)


PRESETS = {"default": default, "device": device, "paper": paper, "ci": ci}
"""Presets of the task `coverage` by name."""
