"""Samples of several sequences: cached in memory, split for validation, without near-duplicates.

Near-duplicates are images that were resized, mirrored or compressed. They are detected by a
perceptual hash: the signs of the low frequencies of the gray image, from a discrete cosine
transform (Zauner, Implementation and Benchmarking of Perceptual Image Hash Functions, 2010, section
3.2.1, keeps 64). Mirroring flips the signs at odd frequencies, and transposition transposes the
signs, so that one hash gives the hashes of all eight orientations of an image.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy
import torch
from torch import Tensor

from vrcaps.core import rng
from vrcaps.core.errors import InputError, reason_of
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.learn.perturbation import Perturbation
from vrcaps.learn.task import Batch, Sample, Task
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Int, Int8, UInt8

    Hashes = Int8[np.ndarray, "n k k"]

_KEPT_BYTES = 4 * 10**9
_IMAGES = ("image", "before", "after")
_HELD_OUT = 0.2
"""Fraction of frames that is held out if the data has no split."""
_MIN_GROUPS, _BLOCKS = 5, 20
"""Minimum number of patients or sequences, and number of blocks, that are resampled."""
_SIDE, _FREQUENCIES = 64, 16
"""Side of the gray image [px], and number of frequencies kept per axis."""
NEAR = 0.12
"""Maximum fraction of different signs of near-duplicates; `docs/concepts/learning.md` has the error
rates of this threshold."""
_AT_ONCE = 2048


@dataclass
class Samples:
    """Frames that a task can use.

    Attributes:
        task: Task that reads the frames.
        frames: Sequence and index of each frame.
        skipped: Reasons of unreadable frames, by name; they are counted but not used.
        perturbation: Change of each frame before it is read; None for none.
    """

    task: Task
    frames: Sequence[tuple[FrameSequence, int]]
    skipped: dict[str, str] = field(default_factory=dict)
    perturbation: Perturbation | None = None
    _kept: dict[int, Sample] = field(default_factory=dict, repr=False)
    _num_bytes: int = 0

    def __len__(self) -> int:
        return len(self.frames)

    def get(self, position: int) -> Sample | None:
        """Return a sample; None if its files are damaged."""
        if position in self._kept:
            return self._kept[position]
        sequence, index = self.frames[position]
        name = f"{sequence.name}, frame {index}"
        if name in self.skipped:
            return None
        try:
            sample = self._read(sequence, index)
        except (InputError, OSError) as error:
            self.skipped[name] = reason_of(error)
            return None
        size = sum(getattr(array, "nbytes", 0) for array in sample.values())
        if self._num_bytes + size <= _KEPT_BYTES:
            self._num_bytes += size
            self._kept[position] = sample
        return sample

    def _read(self, sequence: FrameSequence, index: int) -> Sample:
        if self.perturbation is None:
            return self.task.sample(sequence, index)
        return self.task.perturbed_sample(sequence, index, self.perturbation)

    def next(self, position: int) -> Sample:
        """Return a sample, or the next readable one.

        Raises:
            InputError: If none can be read.
        """
        for step in range(len(self)):
            sample = self.get((position + step) % len(self))
            if sample is not None:
                return sample
        raise InputError(f"No frame can be read: {next(iter(self.skipped.values()), 'none')}")

    def subset(self, fraction: float, seed: int) -> Samples:
        """Random fraction of the frames; smaller fractions are subsets of larger ones."""
        order = rng.stream(seed, "learn/fraction").permutation(len(self))
        kept = np.sort(order[: max(1, round(fraction * len(self)))])
        return Samples(self.task, [self.frames[k] for k in kept], self.skipped)

    def evenly(self, count: int) -> Int[np.ndarray, " m"]:
        """Indices of at most `count` frames, evenly spaced."""
        return np.unique(np.linspace(0, len(self) - 1, min(count, len(self))).astype(int))


def frame_groups(frames: Sequence[tuple[FrameSequence, int]]) -> tuple[list[str], str]:
    """Group of each frame for confidence intervals, and the kind of the groups.

    Frames of one patient are alike, so whole groups are resampled: patients if there are five or
    more, otherwise sequences if there are five or more, otherwise blocks of consecutive frames,
    about twenty in total. Intervals over blocks do not contain the variation between patients.

    Returns:
        The groups, and `patient`, `sequence` or `block`.
    """
    for kind in ("patient", "sequence"):
        names = [one.patient if kind == "patient" else one.name for one, _ in frames]
        if None not in names and len({*names}) >= _MIN_GROUPS:
            return [str(name) for name in names], kind
    length = max(1, len(frames) // _BLOCKS)
    counts: Counter[str] = Counter()
    blocks = []
    for one, _ in frames:
        blocks.append(f"{one.name}, block {counts[one.name] // length}")
        counts[one.name] += 1
    return blocks, "block"


def samples_of(task: Task, sequences: Sequence[FrameSequence]) -> Samples:
    """Collect all usable frames of sequences.

    Raises:
        InputError: If a sequence lacks a required channel, or there is no frame.
    """
    if not sequences:
        raise InputError(
            f"There is no recording for {task.kind}. Choose another split, or make a data set with "
            "more patients."
        )
    frames = [frame for one in sequences for frame in _frames(task, one)]
    if not frames:
        names = ", ".join(one.name for one in sequences[:3])
        raise InputError(f"No frame of {names} can be used for {task.kind}.")
    return Samples(task, frames)


def split_samples(task: Task, sequences: Sequence[FrameSequence]) -> tuple[Samples, Samples]:
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
        return samples_of(task, sequences), samples_of(task, held)
    patients = sorted({one.patient for one in sequences if one.patient})
    if len(patients) * _HELD_OUT >= 1.0:
        last = set(patients[-round(len(patients) * _HELD_OUT) :])
        train = [one for one in sequences if one.patient not in last]
        held = [one for one in sequences if one.patient in last]
        return samples_of(task, train), samples_of(task, held)
    before, after = [], []
    for one in sequences:
        frames = _frames(task, one)
        cut = len(frames) - round(_HELD_OUT * len(frames))
        before.extend(frames[:cut])
        after.extend(frames[cut:])
    if not before or not after:
        raise InputError(f"Too few frames to train {task.kind}. Allowed: 5 or more.")
    return Samples(task, before), Samples(task, after)


def _frames(task: Task, sequence: FrameSequence) -> list[tuple[FrameSequence, int]]:
    """Usable frames of a sequence."""
    sequence = task.prepare(sequence)
    return [(sequence, index) for index in task.items(sequence)]


def batch_of(samples: Sequence[Sample], device: str = "cpu") -> Batch:
    """Tensors of samples: images from 0 to 1, with channels before rows."""

    def convert(name: str) -> Tensor | list[object]:
        values = [sample[name] for sample in samples]
        if not isinstance(values[0], np.ndarray):
            return values
        stacked = np.stack(values)
        if stacked.ndim == 4:
            stacked = np.ascontiguousarray(np.moveaxis(stacked, -1, 1))
        tensor = torch.from_numpy(stacked).to(device)
        return tensor.float() / 255.0 if name in _IMAGES else tensor

    return {name: convert(name) for name in samples[0]}


def image_hash(image: UInt8[np.ndarray, "h w 3"]) -> Int8[np.ndarray, "k k"]:
    """Signs of the low frequencies of an image, −1 or 1; 0 for its mean."""
    from PIL import Image

    size = (_SIDE, _SIDE)
    gray = Image.fromarray(image).convert("L").resize(size, Image.Resampling.BOX)
    waves = np.asarray(scipy.fft.dctn(np.asarray(gray, float), norm="ortho"))
    low = waves[:_FREQUENCIES, :_FREQUENCIES]
    signs = np.where(low > 0.0, 1, -1).astype(np.int8)
    signs[0, 0] = 0
    return signs


def near_duplicates(first: Hashes, second: Hashes, near: float = NEAR) -> Int[np.ndarray, "m 2"]:
    """Return pairs of images that are near-duplicates, up to mirroring and rotation by 90°.

    Args:
        first: Hashes of images.
        second: Hashes of other images.
        near: Maximum fraction of signs that differ.

    Returns:
        A row for each image of the second set that has a near-duplicate in the first: the index of
            the nearest image there, and its own index; in the order of the second set.
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), int)
    known = first.reshape(len(first), -1).astype(np.float32)
    bits = _FREQUENCIES**2 - 1
    pairs = []
    for start in range(0, len(second), _AT_ONCE):
        part = second[start : start + _AT_ONCE]
        alike = np.full(len(part), -1.0)
        nearest = np.zeros(len(part), int)
        for turned in _positions(part):
            same = turned.reshape(len(part), -1).astype(np.float32) @ known.T
            best = same.argmax(axis=1)
            value = same[np.arange(len(part)), best]
            nearest = np.where(value > alike, best, nearest)
            alike = np.maximum(alike, value)
        matches = np.flatnonzero((bits - alike) / 2.0 <= near * bits)
        pairs.append(np.stack([nearest[matches], matches + start], axis=1))
    return np.concatenate(pairs)


def without_duplicates(
    samples: Samples, others: Samples, *, progress: ProgressReport = no_report
) -> tuple[Samples, dict[str, str]]:
    """Remove the training frames that are near-duplicates of validation or test frames.

    Frames of episodes are not compared: they differ by patient, and no real image is one of them.
    Frames that cannot be read are kept; training skips and reports them.

    Args:
        samples: Training frames.
        others: Validation or test frames.
        progress: Called with the number of images read and the total.

    Returns:
        The remaining frames, and a map from the names of removed frames to those of their
            duplicates.

    Raises:
        InputError: If no frame would remain.
    """
    own = [k for k, (one, _) in enumerate(samples.frames) if one.episode is None]
    known = [k for k, (one, _) in enumerate(others.frames) if one.episode is None]
    if not own or not known:
        return samples, {}
    frames = [*(others.frames[k] for k in known), *(samples.frames[k] for k in own)]
    hashes = []
    for done, (sequence, index) in enumerate(frames):
        hashes.append(_hash_of(sequence, index))
        progress(done + 1, len(frames))
    read = [k for k, one in enumerate(hashes) if one is not None]
    first = [k for k in read if k < len(known)]
    second = [k for k in read if k >= len(known)]
    there, here = (np.array([hashes[k] for k in part]) for part in (first, second))
    pairs = near_duplicates(there, here)
    matches = {second[own_]: first[other] for other, own_ in pairs}
    names = {_name(*frames[k]): _name(*frames[other]) for k, other in matches.items()}
    dropped = {own[k - len(known)] for k in matches}
    left = [frame for k, frame in enumerate(samples.frames) if k not in dropped]
    if not left:
        name, other = next(iter(names.items()))
        raise InputError(
            f"All {len(names)} training frames are near-duplicates of validation or test frames: "
            f"{name} is {other}. Give other data, or --duplicates keep."
        )
    return Samples(samples.task, left, samples.skipped), names


def _hash_of(sequence: FrameSequence, index: int) -> Int8[np.ndarray, "k k"] | None:
    try:
        return image_hash(sequence.image("rgb", index))
    except (InputError, OSError):
        return None  # training reports it


def _name(sequence: FrameSequence, index: int) -> str:
    return f"{sequence.name}, frame {index}"


def _positions(hashes: Hashes) -> Iterator[Hashes]:
    """Yield the hashes of the eight orientations: original, mirrored and transposed."""
    sign = np.where(np.arange(_FREQUENCIES) % 2 == 0, 1, -1).astype(np.int8)
    for one in (hashes, hashes.transpose(0, 2, 1)):
        yield one
        yield one * sign
        yield one * sign[:, None]
        yield one * sign * sign[:, None]
