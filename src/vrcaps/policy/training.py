"""Training of a policy in a folder: settings, checkpoints, progress, and the trained policies."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import numpy as np

from vrcaps.config.convert import to_plain
from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256, read_arrays, write_arrays, write_csv
from vrcaps.env.organs import check_names
from vrcaps.env.settings import EnvSettings
from vrcaps.organ.surface import OrganSurface
from vrcaps.policy.mlp_policy import write_mlp_policy
from vrcaps.policy.ppo import Ppo, PpoSettings, require_learner
from vrcaps.policy.score import Score
from vrcaps.policy.warm_start import CHECKPOINT, start_file, warm_start
from vrcaps.scenario.scenario import OrganFile, OrganGenerated
from vrcaps.training.folder import begin_training
from vrcaps.training.threads import exact_torch

if TYPE_CHECKING:
    from vrcaps.policy.mlp_policy import MlpPolicy

PROGRESS = "progress.csv"
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
    seed: Annotated[int, Range(min=0)] = 0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        num_rounds: Number of completed rounds.
        total: Total number of rounds.
        rows: Statistics of each round.
        best: Maximum score of an evaluation; None before the first.
    """

    num_rounds: int
    total: int
    rows: tuple[dict[str, float], ...] = ()
    best: float | None = None


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

    A completed training continues if `num_actions` has grown since; an annealed learning rate then
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
        InputError: If the folder holds something else, or a training of other settings or versions,
            or the start does not fit the settings.
        UnknownNameError: If there is no organ or no capsule of a name.
        MissingExtraError: If a package of the learner is not installed.
    """
    check_names(settings.env)
    stated = plain_settings(settings)
    if start is not None:
        stated["start"] = file_sha256(start_file(start))
    require_learner()
    begin = partial(
        begin_training,
        *(out, stated, _PACKAGES),
        is_forced=is_forced,
        growing=("learner.num_actions",),
    )
    if start is None:
        begin()
    with exact_torch(threads):
        learner = Ppo(settings.env, settings.learner, settings.seed)
        if start is not None:
            warm_start(learner, start_file(start))  # one that does not fit leaves no folder
            begin()
        if tensorboard is not None:
            learner.log_to(tensorboard)
        progress = _run(settings, out, learner, report)
        learner.close()
    return progress


def _run(
    settings: TrainingSettings, out: Path, learner: Ppo, report: Callable[[Progress], None]
) -> Progress:
    """Run all rounds from the last checkpoint on."""
    score = Score(settings.env, settings.learner.evaluation_episodes, settings.seed)
    progress = _read_checkpoint(out, learner)
    report(progress)
    while progress.num_rounds < progress.total:
        progress = _round(settings, out, learner, score, progress)
        _write_checkpoint(out, learner, progress)
        report(progress)
    return progress


def _round(
    settings: TrainingSettings, out: Path, learner: Ppo, score: Score, progress: Progress
) -> Progress:
    """Run one round, and the evaluation that is due after it."""
    number, began = progress.num_rounds, time.perf_counter()
    row = {"round": number + 1.0, "actions": (number + 1.0) * learner.actions_per_round}
    row |= learner.run_round(number)
    policy, best, every = learner.policy(), progress.best, settings.learner.evaluate_every
    is_last = number + 1 == progress.total
    if every and ((number + 1) % every == 0 or is_last):
        found = score(policy)
        row |= {f"evaluation_{name}": value for name, value in found.items()}
        if best is None or found["reward"] > best:
            best = found["reward"]
            _write_policy(out / BEST, policy, settings, number + 1)
    if is_last:
        _write_policy(out / POLICY, policy, settings, number + 1)
        if not every:
            _write_policy(out / BEST, policy, settings, number + 1)
    row["seconds"] = time.perf_counter() - began
    return Progress(number + 1, progress.total, (*progress.rows, row), best)


def _write_policy(path: Path, policy: MlpPolicy, settings: TrainingSettings, done: int) -> None:
    write_mlp_policy(path, policy, {"rounds": done, "seed": settings.seed})


def plain_settings(settings: TrainingSettings) -> dict[str, Any]:
    """Settings as plain values, see `plain_environment`."""
    learner = to_plain(settings.learner, PpoSettings)
    return {"env": plain_environment(settings.env), "learner": learner, "seed": settings.seed}


def plain_environment(env: EnvSettings) -> dict[str, Any]:
    """Settings of an environment as plain values; an organ in memory as its name and checksum."""
    hints = get_type_hints(EnvSettings)
    plain = {
        f.name: to_plain(getattr(env, f.name), hints[f.name])
        for f in fields(env)
        if f.name != "organs"
    }
    plain["organs"] = [
        {"name": organ.name, "sha256": hashlib.sha256(organ.vertices.tobytes()).hexdigest()}
        if isinstance(organ, OrganSurface)
        else to_plain(organ, OrganGenerated | OrganFile)
        for organ in env.organs
    ]
    return plain


def _read_checkpoint(out: Path, learner: Ppo) -> Progress:
    """Read the progress of a training and restore the learner's state."""
    path = out / CHECKPOINT
    if not path.is_file():
        return Progress(0, learner.num_rounds)
    try:
        arrays = read_arrays(path)
        stated = json.loads(str(arrays.pop("progress")))
        learner.load(arrays)
        return Progress(
            stated["num_rounds"], learner.num_rounds, tuple(stated["rows"]), stated["best"]
        )
    except Exception as error:  # errors of PyTorch for damaged states have no common base
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path} is damaged ({reason}). Give a new folder.") from error


def _write_checkpoint(out: Path, learner: Ppo, progress: Progress) -> None:
    stated = {"num_rounds": progress.num_rounds, "rows": progress.rows, "best": progress.best}
    write_csv(out / PROGRESS, progress.rows)  # first, so that the checkpoint completes the state
    write_arrays(out / CHECKPOINT, {**learner.state(), "progress": np.array(json.dumps(stated))})
