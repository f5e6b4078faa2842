"""Training settings by preset and task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import UnknownNameError
from vrcaps.learn.initialize import SCRATCH
from vrcaps.learn.registry import AnyTask
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask
from vrcaps.learn.training import TrainSettings
from vrcaps.scenario.settings import changed, parse_change

_ENDO_L2H: dict[str, Any] = {
    "size": 1024,
    "validation_size": 1024,
    "generator": "attention-unet",
    "halvings": 8,
    "adversarial": 0.01,
    "content": 3e-4,
    "style": 7e-5,
}
"""Super-resolution settings of the paper; the user sets the factor, which is 4 in the paper."""


def default(learner: AnyTask) -> TrainSettings:
    """Default settings of vrcaps."""
    return TrainSettings(learner)


def paper(learner: AnyTask) -> TrainSettings:
    """Settings of the paper (Incetan et al. 2021), and default settings where it states none.

    Classification: ResNet-152 trained from scratch, 10 epochs of 8,714 images with batch size 32,
    learning rate 1e-3. Super-resolution: EndoL2H from 256 to 1024 pixels, 100 epochs of 6,400
    images. Batch size, learning rate and the weight of the adversarial loss (1 : 100 relative to
    the absolute difference) are those of its published program. That program defines content and
    style losses but never uses them, and the text gives no weights: these weights make each as
    large as the adversarial term at the start of training.
    """
    if isinstance(learner, SuperResolutionTask):
        learner = replace(learner, **_ENDO_L2H)
        return TrainSettings(
            learner, start=SCRATCH, steps=640_000, batch=1, rate=2e-4, weight_decay=0.0
        )
    if not isinstance(learner, ClassificationTask):
        return default(learner)
    learner = replace(learner, encoder="resnet152", size=224)
    return TrainSettings(learner, start=SCRATCH, steps=2723, batch=32, rate=1e-3)


def ci(learner: AnyTask) -> TrainSettings:
    """Smoke-test preset: runs for a minute on one core."""
    learner = replace(learner, size=64)
    return TrainSettings(
        learner, steps=60, batch=4, rate=2e-3, evaluate_every=30, evaluation_frames=20
    )


PRESETS = {"ci": ci, "default": default, "paper": paper}


def settings_of(
    learner: AnyTask,
    preset: str,
    data: Sequence[str],
    start: str,
    changes: Sequence[str],
    *,
    validation: Sequence[str] = (),
) -> TrainSettings:
    """Return the settings of a preset with changes.

    Args:
        learner: The task and its settings.
        preset: Name of the preset.
        data: Sources of the training data, for the record.
        start: Weight initialization; empty for the preset's.
        changes: Texts NAME=VALUE.
        validation: Sources of the validation data, for the record.

    Raises:
        UnknownNameError: If there is no such preset or setting.
        InputError: If a value is not allowed.
    """
    if preset not in PRESETS:
        raise UnknownNameError("preset", preset, PRESETS)
    settings = replace(PRESETS[preset](learner), data=tuple(data), validation=tuple(validation))
    plain: dict[str, Any] = to_plain(settings, TrainSettings)
    for path, value in map(parse_change, [*changes, *([f"start={start}"] if start else [])]):
        plain = changed(plain, path, value)
    return from_plain(TrainSettings, plain, at="settings")
