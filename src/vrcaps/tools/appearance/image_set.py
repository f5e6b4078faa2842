"""Sets of images to compare: the same square of the field of view of each image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.rng import stream
from vrcaps.metrics.appearance import at_most_per_group

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.recording.frame_sequence import FrameSequence

DISC = 224
"""Diameter to which the field of view is scaled [px]."""
SIDE = 146
"""Side of the compared square in the middle of it [px]; its corners are within the disc, and
outlines of the view and text in its corners are not."""
_DARK = 24
"""Maximum channel value of the border around a picture [of 255]."""
_MIN_FILLED = 0.1
"""Minimum fraction of brighter pixels in a row or column of the picture."""
_MAX_PER_GROUP = 22
"""Maximum number of images of one patient, so that no patient decides."""


@dataclass(frozen=True)
class ImageSet:
    """Views of one set.

    Attributes:
        name: Name of the set, for tables.
        views: Central squares of the fields of view, sRGB [n s s 3].
        groups: Patient, or sequence if no patient is known, of each view [n].
        names: Name of each image.
    """

    name: str
    views: UInt8[np.ndarray, "n s s 3"]
    groups: NDArray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.views)

    def subset(self, indices: NDArray) -> ImageSet:
        """The views of some indices."""
        names = tuple(self.names[k] for k in indices)
        return ImageSet(self.name, self.views[indices], self.groups[indices], names)


def central_view(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "s s 3"]:
    """Central square of the field of view of an image.

    The field of view is the bounding box of the rows and columns of which a tenth is brighter than
    a dark border. The square around its center, with the length of its shorter side, is scaled to
    `DISC` pixels, of which the middle `SIDE` are returned. A picture without a border is used in
    the same way, so that both kinds show about the same angle.

    Args:
        image: sRGB image with or without a border.
    """
    from PIL import Image

    bright = image.max(axis=-1) > _DARK
    rows, columns = (_extent(bright.mean(axis=axis)) for axis in (1, 0))
    half = 0.5 * min(rows[1] - rows[0], columns[1] - columns[0])
    y, x = 0.5 * sum(rows), 0.5 * sum(columns)
    kind = Image.Resampling.BOX if 2.0 * half > DISC else Image.Resampling.BICUBIC
    box = (x - half, y - half, x + half, y + half)
    disc = np.asarray(Image.fromarray(image).resize((DISC, DISC), kind, box=box))
    first = (DISC - SIDE) // 2
    return np.ascontiguousarray(disc[first : first + SIDE, first : first + SIDE])


def _extent(filled: NDArray) -> tuple[int, int]:
    """First and last-but-one index of the lines that belong to the picture."""
    lines = np.flatnonzero(filled > _MIN_FILLED)
    return (int(lines[0]), int(lines[-1]) + 1) if lines.size else (0, len(filled))


def read_image_set(
    name: str,
    sequences: Sequence[FrameSequence],
    *,
    max_images: int,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> ImageSet:
    """Read views of sequences: at most `max_images`, drawn at random from all patients.

    Args:
        name: Name of the set.
        sequences: Sequences with the channel `rgb`.
        max_images: Maximum number of images.
        seed: Seed of the draw.
        progress: Called with the number of images read and their total.

    Raises:
        InputError: If there are fewer than three images, or one cannot be read.
    """
    require(max_images >= 3, "max_images", max_images, "3 or more")
    frames = [(one, k) for one in sequences if "rgb" in one.channels for k in range(len(one))]
    if len(frames) < 3:
        raise InputError(f"{name} has {len(frames)} images. Allowed: 3 or more.")
    groups = np.array([one.patient or one.name for one, _ in frames])
    is_grouped = len(np.unique(groups)) > 1
    chosen = at_most_per_group(groups, _MAX_PER_GROUP) if is_grouped else np.arange(len(frames))
    drawn = np.sort(stream(seed, "looks/images").permutation(chosen)[:max_images])
    views = []
    for done, index in enumerate(drawn):
        sequence, frame = frames[index]
        views.append(central_view(sequence.image("rgb", frame)))
        if progress is not None:
            progress(done + 1, len(drawn))
    names = tuple(f"{frames[k][0].name}/{frames[k][1]}" for k in drawn)
    return ImageSet(name, np.stack(views), groups[drawn], names)
