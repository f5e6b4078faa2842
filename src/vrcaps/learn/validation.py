"""Evaluation: metrics and pictures of a trained network on frames with ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.samples import Samples, batch_of
from vrcaps.learn.task import Sample, Task

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

_BATCH = 8
_SHOWN = 6


@dataclass(frozen=True)
class EvaluationResult:
    """Result of an evaluation.

    Attributes:
        scores: Metrics of the learner.
        outputs: The network's output for each frame.
        samples: Input and ground truth of each frame.
    """

    scores: Mapping[str, float]
    outputs: list[NDArray]
    samples: list[Sample]


def validate(
    trained: TrainedNetwork, samples: Samples, most: int | None = None
) -> EvaluationResult:
    """Evaluate a network on frames; unreadable ones are omitted and noted in `samples.skipped`.

    Args:
        trained: Task and network.
        samples: Frames with ground truth.
        most: Maximum number of frames, evenly spaced; None for all.

    Raises:
        InputError: If no frame can be read.
    """
    numbers = samples.evenly(len(samples) if most is None else most)
    known = [sample for k in numbers if (sample := samples.get(int(k))) is not None]
    if not known:
        samples.next(0)  # raises with the reason
    is_one_size = len({sample["image"].shape for sample in known}) == 1
    step = _BATCH if is_one_size else 1
    learner, outputs, losses = trained.learner, [], []
    for first in range(0, len(known), step):
        batch = batch_of(known[first : first + step], trained.device)
        outputs.extend(trained(batch))
        if learner.figure.name == "loss":
            losses.append(trained.loss(batch))
    scores = dict(learner.scores(outputs, known))
    if losses:
        scores["loss"] = float(np.mean(losses))
    return EvaluationResult(scores, outputs, known)


def write_pictures(
    path: Path, learner: Task, found: EvaluationResult
) -> UInt8[np.ndarray, "h w 3"]:
    """Write a picture of a few frames below one another and return it."""
    from PIL import Image

    chosen = np.unique(np.linspace(0, len(found.samples) - 1, _SHOWN).astype(int))
    rows = [learner.picture(found.outputs[k], found.samples[k]) for k in chosen]
    picture = below_one_another(rows)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(picture).save(path)
    return picture


def below_one_another(pictures: Sequence[NDArray]) -> UInt8[np.ndarray, "h w 3"]:
    """Stack pictures vertically, with black padding of narrow ones."""
    width = max(picture.shape[1] for picture in pictures)
    wide = [np.pad(one, ((0, 0), (0, width - one.shape[1]), (0, 0))) for one in pictures]
    return np.concatenate(wide, axis=0)
