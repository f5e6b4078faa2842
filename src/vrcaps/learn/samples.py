"""Samples of several sequences: cached in memory, and split for validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import InputError, reason_of
from vrcaps.learn.networks import require_torch
from vrcaps.learn.task import Batch, Sample, Task
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Int

_KEPT_BYTES = 4 * 10**9
_IMAGES = ("image", "before", "after")
_HELD_OUT = 0.2
"""Fraction of frames that is held out if the data has no split."""


@dataclass
class Samples:
    """Frames that a learner can use.

    Attributes:
        learner: Task that reads the frames.
        frames: Sequence and index of each frame.
        skipped: Reasons of unreadable frames, by name; they are counted but not used.
    """

    learner: Task
    frames: Sequence[tuple[FrameSequence, int]]
    skipped: dict[str, str] = field(default_factory=dict)
    _kept: dict[int, Sample] = field(default_factory=dict, repr=False)
    _num_bytes: int = 0

    def __len__(self) -> int:
        return len(self.frames)

    def get(self, number: int) -> Sample | None:
        """Return a sample; None if its files are damaged."""
        if number in self._kept:
            return self._kept[number]
        sequence, index = self.frames[number]
        name = f"{sequence.name}, frame {index}"
        if name in self.skipped:
            return None
        try:
            sample = self.learner.sample(sequence, index)
        except (InputError, OSError) as error:
            self.skipped[name] = reason_of(error)
            return None
        size = sum(getattr(array, "nbytes", 0) for array in sample.values())
        if self._num_bytes + size <= _KEPT_BYTES:
            self._num_bytes += size
            self._kept[number] = sample
        return sample

    def next(self, number: int) -> Sample:
        """Return a sample, or the next readable one.

        Raises:
            InputError: If none can be read.
        """
        for step in range(len(self)):
            sample = self.get((number + step) % len(self))
            if sample is not None:
                return sample
        raise InputError(f"No frame can be read: {next(iter(self.skipped.values()), 'none')}")

    def subset(self, fraction: float, seed: int) -> Samples:
        """Random fraction of the frames; smaller fractions are subsets of larger ones."""
        order = rng.stream(seed, "learn/fraction").permutation(len(self))
        kept = np.sort(order[: max(1, round(fraction * len(self)))])
        return Samples(self.learner, [self.frames[k] for k in kept], self.skipped)

    def evenly(self, count: int) -> Int[np.ndarray, " m"]:
        """Indices of at most `count` frames, evenly spaced."""
        return np.unique(np.linspace(0, len(self) - 1, min(count, len(self))).astype(int))


def samples_of(learner: Task, sequences: Sequence[FrameSequence]) -> Samples:
    """Collect all usable frames of sequences.

    Raises:
        InputError: If a sequence lacks a required channel, or there is no frame.
    """
    frames = [frame for one in sequences for frame in _frames(learner, one)]
    if not frames:
        names = ", ".join(one.name for one in sequences[:3]) or "nothing"
        raise InputError(f"There is no frame to learn {learner.kind} from in {names}.")
    return Samples(learner, frames)


def split_samples(learner: Task, sequences: Sequence[FrameSequence]) -> tuple[Samples, Samples]:
    """Split frames into training and validation frames.

    Existing splits `train` and `val` are kept. Data without a `val` split is split by patient if it
    has five or more patients; otherwise the last fifth of each sequence is held out. `test` is not
    used.

    Raises:
        InputError: If either would be empty.
    """
    held = [one for one in sequences if one.split == "val"]
    sequences = [one for one in sequences if one.split in (None, "train")]
    if held:
        return samples_of(learner, sequences), samples_of(learner, held)
    patients = sorted({one.patient for one in sequences if one.patient})
    if len(patients) * _HELD_OUT >= 1.0:
        last = set(patients[-round(len(patients) * _HELD_OUT) :])
        train = [one for one in sequences if one.patient not in last]
        held = [one for one in sequences if one.patient in last]
        return samples_of(learner, train), samples_of(learner, held)
    before, after = [], []
    for one in sequences:
        frames = _frames(learner, one)
        cut = len(frames) - round(_HELD_OUT * len(frames))
        before.extend(frames[:cut])
        after.extend(frames[cut:])
    if not before or not after:
        raise InputError(f"There are too few frames to learn {learner.kind} from: five or more.")
    return Samples(learner, before), Samples(learner, after)


def _frames(learner: Task, sequence: FrameSequence) -> list[tuple[FrameSequence, int]]:
    """Usable frames of a sequence."""
    if isinstance(learner, ClassificationTask):
        sequence = learner.with_classes(sequence)
    return [(sequence, index) for index in learner.items(sequence)]


def batch_of(samples: Sequence[Sample], device: str = "cpu") -> Batch:
    """Tensors of samples: images from 0 to 1, with channels before rows."""
    torch = require_torch()

    def tensor(name: str) -> Any:
        values = [sample[name] for sample in samples]
        if not isinstance(values[0], np.ndarray):
            return values
        stacked = np.stack(values)
        if stacked.ndim == 4:
            stacked = np.ascontiguousarray(np.moveaxis(stacked, -1, 1))
        found = torch.from_numpy(stacked).to(device)
        return found.float() / 255.0 if name in _IMAGES else found

    return {name: tensor(name) for name in samples[0]}
