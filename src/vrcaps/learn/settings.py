"""Settings of a training of a network, and their presets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from vrcaps.config.convert import from_plain
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.rng import MAX_SEED
from vrcaps.learn.registry import FORMER_TASKS, TASKS, current_settings
from vrcaps.learn.task import Task
from vrcaps.training import changed_settings, preset_named

SCRATCH, IMAGENET = "scratch", "imagenet"


@dataclass(frozen=True)
class TrainSettings:
    """All settings that determine a training's result, besides the files of its data.

    Attributes:
        task: The task and its settings.
        data: Sources of the training data, as given on the command line.
        validation: Validation data, likewise; empty holds out part of the training data.
        start: `imagenet`, `scratch`, or a checkpoint to fine-tune: a file, or a published name.
        steps: Number of training steps.
        batch: Batch size, in frames.
        learning_rate: Maximum learning rate of AdamW, after a linear warm-up; cosine decay to zero.
        weight_decay: Weight decay of AdamW.
        fraction: Fraction of the training frames that is used, for learning curves.
        evaluate_every: Steps between evaluations and checkpoints.
        evaluation_frames: Maximum number of frames of an evaluation, evenly spaced.
        freeze_batch_norm: Whether batch normalization keeps its initial statistics. Otherwise the
            brightness of a small batch, and with it absolute depth, is partly normalized away. Use
            it for fine-tuning, not when training from scratch.
        average_with_start: Fraction f of the trained parameters in the mean that is evaluated and
            written: f * trained + (1 - f) * start. With 1, it is the trained network. Below 1,
            `start` must be a checkpoint of the same task; the mean keeps more of its accuracy on
            other images (Wortsman et al., CVPR 2022, section 3).
        seed: Random seed.
    """

    task: Task
    data: tuple[str, ...] = ()
    validation: tuple[str, ...] = ()
    start: str = IMAGENET
    steps: Annotated[int, Range(1)] = 20_000
    batch: Annotated[int, Range(1)] = 8
    learning_rate: Annotated[float, Range(above=0.0)] = 5e-4
    weight_decay: Annotated[float, Range(0.0)] = 1e-2
    fraction: Annotated[float, Range(above=0.0, max=1.0)] = 1.0
    evaluate_every: Annotated[int, Range(1)] = 500
    evaluation_frames: Annotated[int, Range(1)] = 400
    freeze_batch_norm: bool = False
    average_with_start: Annotated[float, Range(above=0.0, max=1.0)] = 1.0
    seed: Annotated[int, Range(0, MAX_SEED)] = 0

    def __post_init__(self) -> None:
        check_fields(self)


def default(task: Task) -> TrainSettings:
    """Default settings of vrcaps."""
    return TrainSettings(task)


def paper(task: Task) -> TrainSettings:
    """Settings of the paper (Incetan et al. 2021), and default settings where it states none."""
    return _with_preset(TrainSettings(task), "paper")


def ci(task: Task) -> TrainSettings:
    """Smoke-test preset: runs for a minute on one core."""
    settings = TrainSettings(
        task, steps=60, batch=4, learning_rate=2e-3, evaluate_every=30, evaluation_frames=20
    )
    return _with_preset(settings, "ci")


PRESETS = {"ci": ci, "default": default, "paper": paper}


def settings_of(
    task: Task,
    preset: str,
    data: Sequence[str],
    start: str = "",
    changes: Iterable[tuple[str, object]] = (),
    *,
    validation: Sequence[str] = (),
) -> TrainSettings:
    """Return the settings of a preset with changes.

    Args:
        task: The task and its settings.
        preset: Name of the preset.
        data: Sources of the training data, for the record.
        start: Weight initialization; empty for the preset's.
        changes: Dotted paths of settings with their plain values.
        validation: Sources of the validation data, for the record.

    Raises:
        UnknownNameError: If there is no such preset or setting.
        InputError: If a value is not allowed.
    """
    settings = preset_named(PRESETS, preset)(task)
    settings = replace(settings, data=tuple(data), validation=tuple(validation))
    return changed_settings(settings, [*changes, *([("start", start)] if start else [])])


def current_training(plain: object) -> object:
    """Replace the former names of tasks and settings in plain settings of a training."""
    settings = current_settings(TrainSettings, plain)
    task = settings.get("task") if isinstance(settings, dict) else None
    if not isinstance(task, Mapping):
        return settings
    kind = FORMER_TASKS.get(str(task.get("kind")), task.get("kind"))
    if not isinstance(kind, str) or kind not in TASKS:
        return settings
    return {**settings, "task": {**current_settings(TASKS[kind], task), "kind": kind}}


def read_settings(plain: object, at: str) -> TrainSettings:
    """Convert plain settings of a training, of this or an older version.

    Raises:
        InputError: If a setting is unknown or a value is not allowed.
    """
    return from_plain(TrainSettings, current_training(plain), at=at)


def _with_preset(settings: TrainSettings, name: str) -> TrainSettings:
    return changed_settings(settings, settings.task.presets.get(name, {}).items())
