"""Settings of training by preset and by task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from vrcaps.errors import UnknownNameError
from vrcaps.learn.classes import ClassLearner
from vrcaps.learn.first_network import SCRATCH
from vrcaps.learn.registry import AnyLearner
from vrcaps.learn.super_resolution import SuperResolutionLearner
from vrcaps.learn.training import TrainSettings
from vrcaps.scenario.settings import changed, parse_change
from vrcaps.serialization import from_plain, to_plain

_ENDO_L2H: dict[str, Any] = {
    "size": 1024,
    "validation_size": 1024,
    "generator": "attention-unet",
    "halvings": 8,
    "adversarial": 0.01,
    "content": 3e-4,
    "style": 7e-5,
}
"""Settings of super-resolution in the paper; the factor is its user's, 4 in the paper."""


def default(learner: AnyLearner) -> TrainSettings:
    """Ours."""
    return TrainSettings(learner)


def paper(learner: AnyLearner) -> TrainSettings:
    """The paper's (Incetan et al. 2021), where it states any; ours otherwise.

    Classes: ResNet-152 without other weights, 10 epochs of 8,714 images in batches of 32, learning
    rate 1e-3. Super-resolution: EndoL2H from 256 to 1024 pixels, 100 epochs of 6,400 images; batch,
    rate and the weight of the adversary are those of its published program (1 : 100 beside the
    absolute difference). That program has content and style but never uses them, and the text gives
    no weights: ours make each as large as the adversary's share when training begins.
    """
    if isinstance(learner, SuperResolutionLearner):
        learner = replace(learner, **_ENDO_L2H)
        return TrainSettings(
            learner, start=SCRATCH, steps=640_000, batch=1, rate=2e-4, weight_decay=0.0
        )
    if not isinstance(learner, ClassLearner):
        return default(learner)
    learner = replace(learner, encoder="resnet152", size=224)
    return TrainSettings(learner, start=SCRATCH, steps=2723, batch=32, rate=1e-3)


def ci(learner: AnyLearner) -> TrainSettings:
    """A minute on one core: shows that all works, no more."""
    learner = replace(learner, size=64)
    return TrainSettings(
        learner, steps=60, batch=4, rate=2e-3, evaluate_every=30, evaluation_frames=20
    )


PRESETS = {"ci": ci, "default": default, "paper": paper}


def settings_of(
    learner: AnyLearner,
    preset: str,
    data: Sequence[str],
    start: str,
    changes: Sequence[str],
    *,
    validation: Sequence[str] = (),
) -> TrainSettings:
    """Settings of a preset with changes.

    Args:
        learner: The task and its settings.
        preset: Name of the preset.
        data: What is learned from, to be noted.
        start: What training begins with; empty takes the preset's.
        changes: Texts NAME=VALUE.
        validation: What weights are chosen by, to be noted.

    Raises:
        UnknownNameError: If there is no such preset or setting.
        InputError: If a value is impossible.
    """
    if preset not in PRESETS:
        raise UnknownNameError("preset", preset, PRESETS)
    settings = replace(PRESETS[preset](learner), data=tuple(data), validation=tuple(validation))
    plain: dict[str, Any] = to_plain(settings, TrainSettings)
    for path, value in map(parse_change, [*changes, *([f"start={start}"] if start else [])]):
        plain = changed(plain, path, value)
    return from_plain(TrainSettings, plain, at="settings")
