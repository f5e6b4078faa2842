"""Real images in their published layouts, searched in one folder or named individually."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.sim_to_real.images import Pictures, alike, balanced_folds, disc_only, merged
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.formats.io import read_format
from vrcaps.learn.picture_border import Letterbox

LAYOUTS: Mapping[str, tuple[str, ...]] = {
    "wce_bleedgen": ("bleedgen",),
    "hyperkvasir": ("hyperkvasir", "hyper-kvasir"),
    "kvasir_seg": ("kvasir_seg", "kvasir-seg"),
    "bkai": ("bkai", "neopolyp"),
    "c3vd": ("c3vd",),
    "sinus": ("sinus",),
    "unitycam": ("unitycam",),
}
"""Data sets, and parts of the names of folders that they are found by."""


@dataclass(frozen=True)
class Frame:
    """One image.

    Attributes:
        image: Colors, uint8 [h w 3].
        kind: Its class; empty if it has none.
        mask: Lesion or not [h w]; None if it has none.
        patient: Whose it is; None if not known.
        number: In the name of its file, if that is all there is: then files are frames in order.
    """

    image: np.ndarray
    kind: str = ""
    mask: np.ndarray | None = None
    patient: str | None = None
    number: int | None = None


def found_layouts(root: Path | None, named: Sequence[str]) -> dict[str, Path]:
    """Folders of data sets.

    Args:
        root: Folder whose folders are looked through for known names; None looks at none.
        named: Texts LAYOUT=FOLDER, which take precedence.

    Raises:
        UnknownNameError: If a layout is unknown.
        InputError: If a folder is missing, or there is none.
    """
    found: dict[str, Path] = {}
    for text in named:
        name, _, folder = text.partition("=")
        if name not in LAYOUTS:
            raise UnknownNameError("layout", name, LAYOUTS)
        found[name] = Path(folder)
    for folder in (*found.values(), *([] if root is None else [root])):
        if not folder.is_dir():
            raise InputError(f"The folder {folder} does not exist.")
    places = [] if root is None else sorted(path for path in root.iterdir() if path.is_dir())
    for name, parts in LAYOUTS.items():
        fits = [p for p in places if any(part in p.name.lower() for part in parts)]
        if fits:
            found.setdefault(name, fits[0])
    if not found:
        raise InputError(
            f"No known data set in {root}. Known: {', '.join(LAYOUTS)}; folders of other names: "
            "--layout NAME=FOLDER."
        )
    return found


def bleeding_class(name: str) -> str | None:
    """Class of a folder of WCEBleedGen; None for none."""
    return {"bleeding": "bleeding", "non_bleeding": "normal", "non-bleeding": "normal"}.get(name)


def kvasir_class(name: str) -> str | None:
    """Class of a folder of HyperKvasir: polyp, or colitis of any grade; others are left out."""
    if name.startswith("polyp"):
        return "polyp"
    return "colitis" if name.startswith("ulcerative-colitis") else None


def read_classes(
    folder: Path, class_of: Callable[[str], str | None], size: int, *, has_overlays: bool
) -> Pictures:
    """Images with classes, in discs, at the size of a network.

    Args:
        folder: Folders of images, one for each class.
        class_of: Class of a folder's name; None leaves it out.
        size: Longest side [px].
        has_overlays: Whether recorders print into their corners.

    Raises:
        InputError: If there is no image of a class.
    """
    frames = [
        replace(
            frame,
            image=disc_only(small_image(frame.image, size), has_overlays=has_overlays),
            kind=kind,
            mask=None,
        )
        for frame in _frames(folder)
        if (kind := class_of(frame.kind)) is not None
    ]
    return _pictures(folder, frames, "of a known class")


def read_masks(folder: Path, size: int, kind: str) -> Pictures:
    """Images with masks of one kind of lesions, at the size of a network.

    Raises:
        InputError: If there is no image with a mask.
    """
    frames = [
        replace(
            frame,
            image=small_image(frame.image, size),
            kind="",
            mask=small_map(frame.mask, size).astype(np.uint8),
        )
        for frame in _frames(folder)
        if frame.mask is not None
    ]
    return _pictures(folder, frames, "with masks", (kind,))


def read_large(folder: Path, side: int) -> Pictures:
    """Center of large images.

    Raises:
        InputError: If there is no image.
    """
    frames = [
        replace(frame, image=middle(frame.image, side), kind="", mask=None)
        for frame in _frames(folder)
    ]
    return _pictures(folder, frames, "at all")


def middle(image: np.ndarray, side: int) -> np.ndarray:
    """Center of an image, at most a side [px] wide, as a copy."""
    top, left = (max(0, length - side) // 2 for length in image.shape[:2])
    return image[top : top + side, left : left + side].copy()


def small_image(image: np.ndarray, size: int) -> np.ndarray:
    """An image whose longer side has a size [px], as `Letterbox` makes it."""
    fit = Letterbox(image.shape[0], image.shape[1], size)
    return np.ascontiguousarray(fit.image(image)[fit.region])


def small_map(values: np.ndarray, size: int) -> np.ndarray:
    """A map of such an image, each value that of the nearest pixel."""
    fit = Letterbox(values.shape[0], values.shape[1], size)
    return np.ascontiguousarray(fit.nearest(values, 0)[fit.region])


def _frames(folder: Path) -> Iterator[Frame]:
    """Images of a folder with their classes and masks, without those for tests."""
    for sequence in read_format("images", folder):
        if sequence.split == "test":
            continue
        numbers = _numbers(folder / sequence.name, len(sequence))
        for index, number in enumerate(numbers):
            kind = str(sequence.values["class"][index]) if "class" in sequence.values else ""
            has_mask = "label" in sequence.channels
            mask = sequence.image("label", index) > 0 if has_mask else None
            yield Frame(sequence.image("rgb", index), kind, mask, sequence.patient, number)


def _numbers(place: Path, count: int) -> list[int | None]:
    """Indices of the images of a folder, in its order; None if the names are not numbers."""
    stems = [path.stem for path in place.iterdir()] if place.is_dir() else []
    if len(stems) != count or not all(stem.isdecimal() for stem in stems):
        return [None] * count
    return sorted(int(stem) for stem in stems)


def _ordered(frames: Sequence[Frame]) -> list[int | None]:
    """Indices of consecutive frames, by class, across all splits."""
    kinds = sorted({frame.kind for frame in frames})
    most = max((frame.number or 0 for frame in frames), default=0)
    return [None if f.number is None else 2 * most * kinds.index(f.kind) + f.number for f in frames]


def _pictures(
    folder: Path, frames: Sequence[Frame], wanted: str, lesions: Sequence[str] = ()
) -> Pictures:
    if not frames:
        raise InputError(f"{folder} contains no images {wanted}.")
    images, kinds = [f.image for f in frames], [f.kind for f in frames]
    classes = kinds if any(kinds) else ()
    masks = [f.mask for f in frames if f.mask is not None]
    groups = alike(images, _ordered(frames))
    if any(f.patient for f in frames):
        groups = merged(groups, [f.patient or f"image {k}" for k, f in enumerate(frames)])
    folds = balanced_folds(groups, classes)
    return Pictures(folder.name, images, classes, masks, groups, folds, lesions)
