"""Simulated images of data sets of `vrcaps dataset make`: with classes, with masks, or alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

import vrcaps.data
from benchmarks.sim_to_real.cells import digest_of
from benchmarks.sim_to_real.images import Pictures, disc_only
from benchmarks.sim_to_real.real import small_image, small_map
from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.learn.tasks.segmentation import LESION
from vrcaps.recording.frame_sequence import FrameSequence, image_class, lesion_instances

Urls = tuple[str, ...]
"""Folders or URLs of data sets."""
MIN_FRACTION = 0.005
"""Part of an image that a lesion must take to give the image its class."""
_MAX_OF_RAREST = 3
"""Images of a class are at most so many times those of the rarest."""
_NEGATIVES = 0.2
"""Part of the images for masks that show none of the lesions."""


@dataclass(frozen=True)
class OurFrame:
    """Simulated image at the size of a network.

    Attributes:
        image: Colors, uint8 [h w 3].
        lesions: Kind of the lesion at each pixel, its number in `kinds` plus 1; 0 for none.
        kinds: Names of the kinds of lesions.
        shown: Class of the image; None if its lesions are too small.
        is_validation: Whether its patient is not learned from.
    """

    image: np.ndarray
    lesions: np.ndarray
    kinds: tuple[str, ...]
    shown: str | None
    is_validation: bool

    def mask(self, kinds: Sequence[str]) -> np.ndarray:
        """Index of the kind at each pixel, in `kinds` plus 1; 0 for none [h w].

        The kind `lesion` is any that is not named itself.
        """
        any_lesion = kinds.index(LESION) + 1 if LESION in kinds else 0
        numbers = [kinds.index(kind) + 1 if kind in kinds else any_lesion for kind in self.kinds]
        return np.array([0, *numbers], np.uint8)[self.lesions]


@cache
def data_digest(urls: Urls) -> str:
    """Digest of data sets, of twelve digits: plans, versions and complete recordings.

    Raises:
        InputError: If there is no data set, or it is empty.
    """
    known = []
    for url in urls:
        dataset = vrcaps.data.open(url)
        if not len(dataset):
            raise InputError(f"The data set {url} has no whole recording.")
        known.append([dataset.plan, [member.name for member in dataset]])
    return digest_of(known)


@cache
def our_frames(urls: Urls, size: int) -> tuple[OurFrame, ...]:
    """Images of training and validation patients, at the size of a network.

    Raises:
        InputError: If the data set lacks the channels rgb or instance.
    """
    return tuple(
        frame
        for part in our_sequences(urls)
        for sequence in part
        for frame in _frames(sequence, size)
    )


def _frames(sequence: FrameSequence, size: int) -> Iterator[OurFrame]:
    if "instance" not in sequence.channels or sequence.episode is None:
        raise InputError(
            f"{sequence.name} lacks the channel 'instance'. Make the data set with channels "
            '["rgb", "depth", "instance"].'
        )
    lesions = sequence.episode.head["organ"]["lesions"]
    kinds = tuple(sorted({one["kind"] for one in lesions}))
    number_of = np.zeros(1 + max((one["instance"] for one in lesions), default=0), np.uint8)
    for one in lesions:
        number_of[one["instance"]] = 1 + kinds.index(one["kind"])
    for index in range(len(sequence)):
        instance = sequence.image("instance", index)
        yield OurFrame(
            small_image(sequence.image("rgb", index), size),
            small_map(number_of[lesion_instances(instance)], size),
            kinds,
            image_class(instance, lesions, MIN_FRACTION),
            sequence.split == "val",
        )


def our_classes(urls: Urls, classes: Sequence[str], size: int) -> tuple[Pictures, Pictures]:
    """Training and validation images with classes, in discs like the real ones.

    Args:
        urls: Of the data sets.
        classes: Kinds of lesions, or `normal` for images without any; others are left out.
        size: Longest side [px].

    Raises:
        InputError: If there is no image of a class.
    """

    def pictures(frames: Sequence[OurFrame]) -> Pictures:
        shown = np.array([frame.shown or "" for frame in frames])
        members = [np.flatnonzero(shown == name) for name in classes]
        most = _MAX_OF_RAREST * min(len(found) for found in members)
        chance = rng.stream(0, "benchmarks/classes")
        chosen = np.sort(np.concatenate([chance.permutation(found)[:most] for found in members]))
        images = [disc_only(frames[k].image) for k in chosen]
        return Pictures("ours", images, [str(shown[k]) for k in chosen])

    return _by_split(urls, size, pictures, " or of ".join(classes))


def our_masks(urls: Urls, kinds: Sequence[str], size: int) -> tuple[Pictures, Pictures]:
    """Training and validation images with masks of lesions of some kinds, and some without.

    Raises:
        InputError: If no image shows such a lesion.
    """

    def pictures(frames: Sequence[OurFrame]) -> Pictures:
        masks = [frame.mask(kinds) for frame in frames]
        area = np.array([np.mean(mask > 0) for mask in masks])
        shown, empty = np.flatnonzero(area >= MIN_FRACTION), np.flatnonzero(area == 0.0)
        most = round(_NEGATIVES / (1.0 - _NEGATIVES) * len(shown))
        negatives = rng.stream(0, "benchmarks/negatives").permutation(empty)[:most]
        chosen = np.sort(np.concatenate([shown, negatives]))
        return Pictures(
            "ours",
            [frames[k].image for k in chosen],
            masks=[masks[k] for k in chosen],
            kinds=kinds,
        )

    return _by_split(urls, size, pictures, " or of ".join(kinds))


def _by_split(
    urls: Urls, size: int, pictures: Callable[[Sequence[OurFrame]], Pictures], wanted: str
) -> tuple[Pictures, Pictures]:
    """Training and validation images; of a small data set both are training images."""
    frames = our_frames(urls, size)
    train = pictures([frame for frame in frames if not frame.is_validation])
    if not len(train):
        raise InputError(f"{' and '.join(urls)}: no image of {wanted} to learn from.")
    return train, pictures([frame for frame in frames if frame.is_validation]) or train


@cache
def our_sequences(urls: Urls) -> tuple[Sequence[FrameSequence], Sequence[FrameSequence]]:
    """Sequences of training and of validation patients, at full size."""
    datasets = [vrcaps.data.open(url) for url in urls]
    train, validation = (
        [sequence for dataset in datasets for sequence in dataset.sequences(split)]
        for split in ("train", "val")
    )
    return train, validation


def evenly(sequences: Sequence[FrameSequence], most: int) -> list[tuple[FrameSequence, int]]:
    """Frames of sequences, evenly spaced, up to a number."""
    frames = [(sequence, index) for sequence in sequences for index in range(len(sequence))]
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(most, len(frames))).astype(int))
    return [frames[k] for k in chosen]
