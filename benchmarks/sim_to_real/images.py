"""Images in memory, at the input size of networks, with groups and folds.

Frames of one patient are similar. If patients are unknown, near copies and consecutive frames form
one group, and whole groups are held out.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from PIL import Image

from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.recording.frame_sequence import TIME, FrameSequence

FOLDS = 5
_COPY_BITS, _COPY_LEVELS = 24, 24.0
"""Largest difference of near copies: bits of 242 of their hashes (of unrelated images about 90 to
120 differ), and levels of 255 of their mean colors."""
_COPY_CORRELATION, _DETAIL_SIDE = 0.6, 32
"""Least correlation of the details of near copies, and the side at which they are taken [px]."""
_NEXT_BITS, _NEXT_LEVELS = 80, 10.0
"""The same of two frames that follow each other in a video."""
_HASH_SIDE, _DARK = 11, 16


@dataclass(frozen=True)
class Pictures:
    """Images of one set with their annotations.

    Attributes:
        name: Of the set.
        images: Colors, uint8 [h w 3] each.
        classes: Class of each image; empty without classes.
        masks: Kind of the lesion at each pixel, its number in `kinds` plus 1, 0 for none, uint8
            [h w] of each image; empty where there are none.
        groups: Number of each image's group [n]: a patient, a sequence, or near copies.
        folds: Fold by which each image is held out [n]; −1 is never held out.
        kinds: Kinds of lesions of the masks.
    """

    name: str
    images: Sequence[np.ndarray]
    classes: Sequence[str] = ()
    masks: Sequence[np.ndarray] = ()
    groups: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    folds: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    kinds: Sequence[str] = ()

    def __len__(self) -> int:
        return len(self.images)

    def take(self, chosen: np.ndarray) -> Pictures:
        """Some of the images, by index."""
        return Pictures(
            self.name,
            [self.images[k] for k in chosen],
            [self.classes[k] for k in chosen] if self.classes else (),
            [self.masks[k] for k in chosen] if self.masks else (),
            self.groups[chosen] if len(self.groups) else self.groups,
            self.folds[chosen] if len(self.folds) else self.folds,
            self.kinds,
        )

    def split(self, fold: int) -> tuple[Pictures, Pictures]:
        """Training images, and those of a fold.

        Raises:
            InputError: If either would be empty.
        """
        held = self.folds == fold
        if held.all() or not held.any():
            raise InputError(f"Fold {fold} of {self.name} holds out {held.sum()} of {held.size}.")
        return self.take(np.flatnonzero(~held)), self.take(np.flatnonzero(held))

    def sequence(self) -> FrameSequence:
        """Images as a frame sequence for tasks."""
        values = {TIME: np.arange(len(self.images), dtype=float)}
        stored: dict[str, Sequence[np.ndarray]] = {"rgb": self.images}
        if self.classes:
            values["class"] = np.array(self.classes)
        if self.masks:
            stored["label"] = self.masks
        return FrameSequence(
            self.name,
            tuple(stored),
            values,
            lambda channel, index: stored[channel][index],
            label_names=("background", *self.kinds),
        )

    @cached_property
    def digest(self) -> str:
        """Digest of images, classes, masks, groups and folds, of twelve digits."""
        found = hashlib.sha256(repr((self.name, list(self.classes))).encode())
        for arrays in (self.images, self.masks, (self.groups, self.folds)):
            for array in arrays:
                found.update(np.ascontiguousarray(array).tobytes())
        return found.hexdigest()[:12]


def disc_only(image: np.ndarray, *, has_overlays: bool = False) -> np.ndarray:
    """Inscribed disc of an image [h w c] or [h w], black around it.

    Devices differ in the shape of their images' edge, and recorders print text and boxes into
    corners; if classes come from different devices, these would distinguish them.

    Args:
        image: Any plane or planes.
        has_overlays: Whether the places where HyperKvasir's recorders print are blackened, too: the
            left sixth, and the left half of the lowest two fifths.
    """
    height, width = image.shape[:2]
    y = (np.arange(height)[:, None] + 0.5) / height
    x = (np.arange(width)[None, :] + 0.5) / width
    kept = np.hypot(x - 0.5, y - 0.5) < 0.49
    if has_overlays:
        kept &= (x > 0.17) & ~((x < 0.5) & (y > 0.6))
    return np.where(kept[..., None] if image.ndim == 3 else kept, image, 0).astype(image.dtype)


def perceptual_hash(image: np.ndarray) -> np.ndarray:
    """242 bits, equal in most places for similar images: signs of differences of neighbors.

    The difference hash, along rows and along columns, of the part of the image that is not black,
    at 11 by 11 places: borders, scale and compression change few bits.
    """
    small = _gray(image, _HASH_SIDE + 1)
    across, down = np.diff(small, axis=1)[:-1], np.diff(small, axis=0)[:, :-1]
    return np.concatenate([across.ravel() > 0.0, down.ravel() > 0.0])


def _gray(image: np.ndarray, side: int) -> np.ndarray:
    """Non-black part of an image as gray values [side side]."""
    bright = image.max(axis=-1) > _DARK
    rows, columns = np.flatnonzero(bright.any(axis=1)), np.flatnonzero(bright.any(axis=0))
    if not rows.size:
        return np.zeros((side, side))
    inner = image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    gray = Image.fromarray(np.ascontiguousarray(inner)).convert("L")
    return np.asarray(gray.resize((side, side), Image.Resampling.BOX), float)


def _detail(image: np.ndarray) -> np.ndarray:
    """Detail finer than a quarter of an image, away from its edge, as a unit vector."""
    from scipy.ndimage import gaussian_filter

    gray = _gray(image, _DETAIL_SIDE)
    place = (np.arange(_DETAIL_SIDE) + 0.5) / _DETAIL_SIDE - 0.5
    inside = np.hypot(place[:, None], place[None]) < 0.38
    fine = (gray - gaussian_filter(gray, _DETAIL_SIDE / 8.0))[inside]
    return fine / max(float(np.linalg.norm(fine)), 1e-9)


def alike(images: Sequence[np.ndarray], order: Sequence[int | None] = ()) -> np.ndarray:
    """Group of each image [n]: near copies, and consecutive frames of one video.

    Near copies have hashes that differ in few bits, nearly the same mean color, and details that
    correlate: smooth walls have alike hashes, since light falls off towards all edges. Frames that
    follow each other need only look somewhat alike; they join all that lies between two of them.

    Args:
        images: Colors [h w 3] each; black outside the view.
        order: Number of each frame where files are numbered, as those of a video are; images
            without a number, and neighbors that look different, follow nothing.
    """
    bits = np.array([perceptual_hash(image) for image in images]).astype(np.float32)
    total = bits.sum(axis=1)
    color = np.array([_mean_color(image) for image in images])
    first, second = np.nonzero(total[:, None] + total[None] - 2.0 * bits @ bits.T <= _COPY_BITS)
    detail = np.array([_detail(image) for image in images])
    near = np.abs(color[first] - color[second]).max(axis=1) <= _COPY_LEVELS
    near &= (detail[first] * detail[second]).sum(axis=1) >= _COPY_CORRELATION
    numbered = np.array([k for k, number in enumerate(order) if number is not None], int)
    chain = numbered[np.argsort([order[k] for k in numbered], kind="stable")]
    before, after = chain[:-1], chain[1:]
    follows = (np.abs(bits[before] - bits[after]).sum(axis=1) <= _NEXT_BITS) & (
        np.abs(color[before] - color[after]).max(axis=1, initial=0.0) <= _NEXT_LEVELS
    )
    ends = np.concatenate([first[near], before[follows]])
    others = np.concatenate([second[near], after[follows]])
    return _components(ends, others, len(images))


def _mean_color(image: np.ndarray) -> np.ndarray:
    """Mean of the pixels that are not black, by channel."""
    shown = image[image.max(axis=-1) > _DARK]
    return shown.mean(axis=0) if len(shown) else np.zeros(3)


def _components(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Number of the connected component of each node [n]."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(links, directed=False)[1]


def merged(groups: np.ndarray, others: Sequence[str]) -> np.ndarray:
    """Groups, merged if they share the name of a patient or sequence."""
    names = np.unique(np.array(others), return_inverse=True)[1] + groups.max() + 1
    joined = _components(groups, names, int(names.max()) + 1)[groups]
    return np.unique(joined, return_inverse=True)[1]


def balanced_folds(
    groups: np.ndarray, classes: Sequence[str], *, folds: int = FOLDS, seed: int = 0
) -> np.ndarray:
    """Fold of each image [n]: whole groups, with the classes balanced over the folds.

    Groups are dealt out, largest first, each to the fold that has fewest images of its classes.

    Args:
        groups: Group of each image [n].
        classes: Class of each image; empty without classes.
        folds: Number of folds.
        seed: Of the order of groups of one size.

    Raises:
        InputError: If there are fewer groups than folds.
    """
    numbers = np.unique(np.array(classes or [""] * len(groups)), return_inverse=True)[1]
    counts = np.zeros((groups.max() + 1, numbers.max() + 1), int)
    np.add.at(counts, (groups, numbers), 1)
    if len(counts) < folds:
        raise InputError(f"There are {len(counts)} groups of images, fewer than {folds} folds.")
    order = rng.stream(seed, "benchmarks/folds").permutation(len(counts))
    order = order[np.argsort(-counts[order].sum(axis=1), kind="stable")]
    filled, fold_of = np.zeros((folds, counts.shape[1])), np.zeros(len(counts), int)
    for group in order:
        fold_of[group] = np.argmin(filled @ counts[group] + 1e-3 * filled.sum(axis=1))
        filled[fold_of[group]] += counts[group]
    return fold_of[groups]
