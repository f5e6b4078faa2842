"""Near-duplicate images by a perceptual hash: copies that were resized, mirrored or compressed.

The hash holds the signs of the low frequencies of the gray image, from a discrete cosine transform
(Zauner, Implementation and Benchmarking of Perceptual Image Hash Functions, 2010, section 3.2.1,
keeps 64). Mirroring flips the signs at odd frequencies, and transposition transposes the signs, so
that one hash gives the hashes of all eight orientations of an image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.learn.samples import Samples

if TYPE_CHECKING:
    from jaxtyping import Int, Int8, UInt8

    from vrcaps.recording.frame_sequence import FrameSequence

    Hashes = Int8[np.ndarray, "n k k"]

_SIDE, _FREQUENCIES = 64, 16
"""Side of the gray image [px], and number of frequencies kept per axis."""
NEAR = 0.12
"""Maximum fraction of different signs of near-duplicates; `docs/concepts/learning.md` has the error
rates of this threshold."""
_AT_ONCE = 2048


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
    for begin in range(0, len(second), _AT_ONCE):
        part = second[begin : begin + _AT_ONCE]
        alike = np.full(len(part), -1.0)
        nearest = np.zeros(len(part), int)
        for turned in _positions(part):
            same = turned.reshape(len(part), -1).astype(np.float32) @ known.T
            best = same.argmax(axis=1)
            value = same[np.arange(len(part)), best]
            nearest = np.where(value > alike, best, nearest)
            alike = np.maximum(alike, value)
        found = np.flatnonzero((bits - alike) / 2.0 <= near * bits)
        pairs.append(np.stack([nearest[found], found + begin], axis=1))
    return np.concatenate(pairs)


def without_duplicates(
    samples: Samples, others: Samples, *, progress: Callable[[int, int], None] | None = None
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
    hashes: list[Any] = []
    for number, (sequence, index) in enumerate(frames):
        hashes.append(_hash_of(sequence, index))
        if progress is not None:
            progress(number + 1, len(frames))
    read = [k for k, found in enumerate(hashes) if found is not None]
    first = [k for k in read if k < len(known)]
    second = [k for k in read if k >= len(known)]
    there, here = (np.array([hashes[k] for k in part]) for part in (first, second))
    pairs = near_duplicates(there, here)
    found = {second[own_]: first[other] for other, own_ in pairs}
    names = {_name(*frames[k]): _name(*frames[other]) for k, other in found.items()}
    dropped = {own[k - len(known)] for k in found}
    left = [frame for k, frame in enumerate(samples.frames) if k not in dropped]
    if not left:
        name, other = next(iter(names.items()))
        raise InputError(
            f"All {len(names)} frames to learn from are among those to validate or test with: "
            f"{name} is {other}. Give other data, or --duplicates keep."
        )
    return Samples(samples.learner, left, samples.skipped), names


def _hash_of(sequence: FrameSequence, index: int) -> Int8[np.ndarray, "k k"] | None:
    try:
        return image_hash(sequence.image("rgb", index))
    except (InputError, OSError):
        return None  # reported in training


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
