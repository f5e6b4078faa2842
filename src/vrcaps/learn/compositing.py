"""Rendered lesions in real images without lesions, with exact masks.

A view is rendered with its lesions and again without them, as a clean twin. The quotient of both
linear radiances states how the lesion changes the color and the shading of the wall, and contains
neither the light nor the wall of the renderer (the quotient image of Shashua and Riklin-Raviv,
TPAMI 23, 2001). A real image is multiplied by it in linear light, so the lesion has the light, the
color cast and the exposure of that image.

Blood dissolved in fluid has no outline on the wall. It is drawn as a `FluidFilm` of random form
with the transmittance of blood, in front of the wall or of other fluids, which images without a
lesion show as well.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
import scipy

from vrcaps.core import rng
from vrcaps.core.color import linear_from_srgb, srgb_from_linear
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import atomic_folder
from vrcaps.core.geometry import smoothstep
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.learn.augment import (
    WALL,
    Fluid,
    FluidFilm,
    fluid_film,
    hemorrhage,
    illumination_of,
    photographed,
)
from vrcaps.learn.picture_border import tissue_of
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import NORMAL, FrameSequence, lesion_instances

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

Pair: TypeAlias = tuple[FrameSequence, FrameSequence]
"""A recording with lesions and its clean twin."""
_RATIOS = (1.0 / 64.0, 2.0)
"""Limits of a quotient, which is meaningless for black wall and highlights."""
_DARKEST = 1e-3
"""Minimum radiance of the clean view, relative to its 95 % quantile; darker pixels keep a quotient
of 1."""
_FEATHER = 0.012
"""Width of the transition within a mask, relative to the longer side of the image."""
_SCALE = (0.75, 2.2)
"""Range of the magnification of a rendered view relative to the real image."""
_OTHER, _IN_FRONT, _HEMORRHAGE = 0.5, 0.2, 0.25
"""Fraction of images with bile, shadow or murky fluid behind the lesion; of those with a lesion
that have it in front; and of the films of blood that are hemorrhagic mucosa."""
_HIDING = 1.0
"""Optical density in green of a fluid that hides the blood behind it."""
_QUALITY = (80, 95)
"""Range of the JPEG quality of written images."""
_DRAWS = 8
"""Maximum number of draws of a lesion's position until it lies in the tissue."""


@dataclass(frozen=True)
class LesionPatch:
    """Change of an image by a lesion.

    Attributes:
        ratio: Quotient of linear light with and without the lesion [h w 3].
        mask: Mask of the lesion [h w].
        kind: Kind of the lesion, such as `bleeding`.
        wall: Mean linear color of the wall without the lesion; only its hue is used.
    """

    ratio: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    kind: str
    wall: Float[np.ndarray, " 3"] = field(default_factory=lambda: WALL)


@dataclass(frozen=True)
class CompositeSettings:
    """Settings of a folder of composites.

    Attributes:
        count: Number of images.
        normal: Fraction of images without a lesion. Half of all images have bile, shadow or murky
            fluid.
        fluid: Fraction of the images with a lesion that show films of blood or hemorrhagic mucosa
            instead of a rendered lesion; a fourth of these show both.
        min_fraction: Minimum fraction of the image that a lesion covers.
        seed: Random seed.
    """

    count: Annotated[int, Range(min=1)] = 1000
    normal: Annotated[float, Range(0.0, 1.0)] = 0.4
    fluid: Annotated[float, Range(0.0, 1.0)] = 0.4
    min_fraction: Annotated[float, Range(0.0, 1.0)] = 0.004
    seed: Annotated[int, Range(0, rng.MAX_SEED)] = 0

    def __post_init__(self) -> None:
        check_fields(self)


def lesion_pairs(sequences: Sequence[FrameSequence]) -> list[Pair]:
    """Pair recordings with lesions with their clean twins: same scenario, without the lesions.

    Raises:
        InputError: If there is no pair, or a recording lacks a channel.
    """
    pairs: dict[str, dict[bool, FrameSequence]] = defaultdict(dict)
    for one in sequences:
        if one.episode is None:
            raise InputError(
                f"{one.name} is not a recording. Give a data set of `vrcaps dataset make`."
            )
        scenario = dict(one.episode.head["scenario"])
        is_clean = bool(scenario.pop("clean_twin", False))
        pairs[json.dumps([scenario, one.name.rpartition("/")[2]])][is_clean] = one
    complete = [(pair[False], pair[True]) for pair in pairs.values() if len(pair) == 2]
    if not complete:
        raise InputError(
            "No recording has a clean twin. Add clean_twin = { each = [false, true] } to the plan."
        )
    for one in (sequence for pair in complete for sequence in pair):
        for channel in ("radiance", "instance"):
            if channel not in one.channels:
                raise InputError(
                    f"{one.name} has no channel {channel!r}. Record the channels 'radiance' and "
                    "'instance'."
                )
    return complete


def rendered_patch(sequence: FrameSequence, twin: FrameSequence, index: int) -> LesionPatch | None:
    """Return the change of a frame by its lesions; None if no lesion is visible.

    Args:
        sequence: Recording with lesions and its channels `radiance` and `instance`.
        twin: Its clean twin.
        index: Index of the frame.

    Raises:
        InputError: If an image cannot be read.
    """
    instance = lesion_instances(sequence.image("instance", index))
    mask = instance > 0
    if not mask.any():
        return None
    with_lesion = sequence.image("radiance", index).astype(float)
    without = twin.image("radiance", index).astype(float)
    largest = int(np.bincount(instance[mask]).argmax())
    assert sequence.episode is not None
    lesions = sequence.episode.head["organ"]["lesions"]
    kind = next(str(one["kind"]) for one in lesions if one["instance"] == largest)
    wall = np.nan_to_num(without).mean(axis=(0, 1))
    return LesionPatch(quotient(with_lesion, without), mask, kind, wall)


def quotient(
    with_lesion: Float[np.ndarray, "h w 3"], without: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w 3"]:
    """Quotient of two linear images, limited to 1/64 to 2; 1 where the second is nearly black."""
    level = _DARKEST * max(float(np.quantile(without, 0.95)), 1e-12)
    is_known = np.isfinite(with_lesion) & np.isfinite(without) & (without > level)
    ratio = np.divide(with_lesion, without, out=np.ones_like(without), where=is_known)
    return np.clip(ratio, *_RATIOS)


def composite(
    image: UInt8[np.ndarray, "h w 3"], patch: LesionPatch, *, hue: float = 0.0
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Composite a lesion into an image.

    Linear light is multiplied by the quotient to the power of a weight, which increases from 0 at
    the mask's outline to 1 within 1.2 % of the longer side. Pixels outside the mask are unchanged.

    Args:
        image: Image without a lesion.
        patch: Change by the lesion, of the same size.
        hue: Degree to which an opaque lesion keeps its rendered hue, 0 to 1. With 0 the hue of the
            wall, relative to that of the rendered one, is taken for a color cast of the camera,
            with 1 for the wall's own, which an opaque lesion hides.

    Returns:
        The image, and the mask of the lesion: that of the patch within the field of view.

    Raises:
        InputError: If the sizes differ, or `hue` is not from 0 to 1.
    """
    size = image.shape[:2]
    require(0.0 <= hue <= 1.0, "hue", hue, "0 to 1")
    require(patch.mask.shape == size, "size of the patch", patch.mask.shape, f"{size}, the image's")
    tissue = tissue_of(image)
    mask = patch.mask & tissue
    if not mask.any():
        return image, mask
    own = linear_from_srgb(image)[tissue].mean(axis=0)
    wall = np.maximum(patch.wall, 1e-12)
    cast = (own / own.sum()) / (wall / wall.sum())
    opacity = np.clip(1.0 - patch.ratio[..., 1:2], 0.0, 1.0)
    ratio = patch.ratio * np.clip(cast, 0.1, 10.0) ** (-hue * opacity)
    return _changed(image, ratio, mask), mask


def _changed(
    image: UInt8[np.ndarray, "h w 3"],
    ratio: Float[np.ndarray, "h w 3"],
    mask: Bool[np.ndarray, "h w"],
) -> UInt8[np.ndarray, "h w 3"]:
    """Image multiplied by a quotient within a mask."""
    distance = scipy.ndimage.distance_transform_edt(mask)
    weight = smoothstep(np.minimum(distance / (_FEATHER * max(mask.shape)), 1.0))
    light = linear_from_srgb(image) * ratio ** weight[..., None]
    return np.where(mask[..., None], srgb_from_linear(light), image)


def placed(patch: LesionPatch, height: int, width: int, draw: np.random.Generator) -> LesionPatch:
    """Rotate, mirror, magnify and shift a patch at random to an image of a size.

    The lights are next to the lens, so no direction of the image [height width] is special. The
    lesion's center lies in the middle 70 % of the image.
    """
    angle = draw.uniform(0.0, 2.0 * np.pi)
    scale = min(patch.mask.shape) / min(height, width)
    scale /= float(np.exp(draw.uniform(*np.log(_SCALE))))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * scale
    turn[:, 1] *= draw.choice((-1.0, 1.0))
    rows, columns = np.nonzero(patch.mask)
    center = np.array([rows.mean(), columns.mean()])
    target = np.array([height, width]) * (0.5 + draw.uniform(-0.35, 0.35, 2))
    offset = center - turn @ target

    def moved(values: np.ndarray, fill: float) -> np.ndarray:
        return scipy.ndimage.affine_transform(
            values, turn, offset, (height, width), order=1, cval=fill, output=np.float32
        )

    logs = np.log(patch.ratio)
    ratio = np.exp(np.stack([moved(logs[..., k], 0.0) for k in range(3)], axis=-1))
    mask = moved(patch.mask.astype(np.float32), 0.0) >= 0.5
    return replace(patch, ratio=ratio, mask=mask)


def write_composites(
    pairs: Sequence[Pair],
    images: Sequence[FrameSequence],
    out: Path,
    settings: CompositeSettings | None = None,
    *,
    progress: ProgressReport = no_report,
) -> dict[str, int]:
    """Write a folder of composites: images and masks by kind of lesion, and normal ones.

    The folders `bleeding` and `bleeding_mask`, and so on, are those that `images:` reads, for
    segmentation of any lesion and for classification. Normal images are treated alike, so neither
    compression nor exposure reveals a lesion. The same arguments give the same files.

    Args:
        pairs: Recordings and clean twins, see `lesion_pairs`.
        images: Real images without lesions.
        out: Folder to create.
        settings: Settings; None for the defaults.
        progress: Called with the number of written images and the total.

    Returns:
        Number of images by kind.

    Raises:
        InputError: If the folder exists, an image cannot be read, there is no view or no image, or
            no view shows a lesion that is large enough.
    """
    settings = settings or CompositeSettings()
    frames = [(one, index) for one in images for index in range(len(one))]
    views = [(*pair, index) for pair in pairs for index in range(len(pair[0]))]
    if not frames or not views:
        raise InputError(f"{len(views)} views and {len(frames)} images are given. Allowed: 1 each.")
    if settings.normal < 1.0 and not any(_is_usable(*view, settings) for view in views):
        raise InputError(
            f"None of {len(views)} views shows a lesion that can cover min_fraction "
            f"{settings.min_fraction:g} of an image. Allowed: 1 or more. Record more frames or "
            "larger lesions."
        )
    counts: dict[str, int] = defaultdict(int)
    with atomic_folder(out) as partial:
        for index in range(settings.count):
            draw = rng.stream(settings.seed, "learn/composite", index)
            sequence, frame = frames[int(draw.integers(len(frames)))]
            image = sequence.image("rgb", frame)
            light, mask, kind = _drawn(image, views, settings, draw)
            made = photographed(light, image, draw)
            _write(partial, f"{index:06d}", made, mask, kind, int(draw.integers(*_QUALITY)))
            counts[kind] += 1
            progress(index + 1, settings.count)
    return dict(counts)


def _is_usable(
    sequence: FrameSequence, twin: FrameSequence, index: int, settings: CompositeSettings
) -> bool:
    """Return whether a view shows a lesion that is large enough when magnified the most."""
    patch = rendered_patch(sequence, twin, index)
    return patch is not None and patch.mask.mean() * _SCALE[1] ** 2 >= settings.min_fraction


def _drawn(
    image: UInt8[np.ndarray, "h w 3"],
    views: Sequence[tuple[FrameSequence, FrameSequence, int]],
    settings: CompositeSettings,
    draw: np.random.Generator,
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], str]:
    """Linear light of one image with a lesion or without, its mask and its kind."""
    hue = float(np.sqrt(draw.uniform()))
    illumination = illumination_of(image, hue)
    light = linear_from_srgb(image)
    if draw.uniform() < _OTHER:
        light = _other_fluid(image, draw).over(light, illumination)
    if draw.uniform() >= settings.normal:
        tissue = tissue_of(image)
        for _ in range(_DRAWS):
            made, mask, kind = light, np.zeros(image.shape[:2], bool), "bleeding"
            way = draw.uniform()
            if way >= settings.fluid or way < 0.25 * settings.fluid:
                patch = rendered_patch(*views[int(draw.integers(len(views)))])
                if patch is not None:
                    made, mask = _with_patch(made, patch, hue, draw)
                    kind = patch.kind if mask.any() else kind
            if way < settings.fluid:
                for _ in range(2 if draw.uniform() < 0.3 else 1):
                    is_spotted = draw.uniform() < _HEMORRHAGE
                    film = hemorrhage(image, draw) if is_spotted else fluid_film(image, draw)
                    made, mask = film.over(made, illumination), mask | film.mask
            if draw.uniform() < _IN_FRONT:
                front = _other_fluid(image, draw)
                made = front.over(made, illumination)
                mask = mask & (front.density[..., 1] < _HIDING)
            mask = mask & tissue
            if mask.mean() >= settings.min_fraction:
                return made, mask, kind
    return light, np.zeros(image.shape[:2], bool), NORMAL


def _with_patch(
    light: Float[np.ndarray, "h w 3"], patch: LesionPatch, hue: float, draw: np.random.Generator
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Linear light with a lesion in a random position, and its mask."""
    moved = placed(patch, light.shape[0], light.shape[1], draw)
    changed, mask = composite(srgb_from_linear(light), moved, hue=hue)
    return np.where(mask[..., None], linear_from_srgb(changed), light), mask


def _other_fluid(image: UInt8[np.ndarray, "h w 3"], draw: np.random.Generator) -> FluidFilm:
    """Film of bile, shadow or murky fluid."""
    fluids: tuple[Fluid, ...] = ("bile", "shadow", "murky")
    return fluid_film(image, draw, fluids[int(draw.integers(len(fluids)))])


def _write(
    folder: Path,
    name: str,
    image: UInt8[np.ndarray, "h w 3"],
    mask: Bool[np.ndarray, "h w"],
    kind: str,
    quality: int,
) -> None:
    """Write an image as JPEG and its mask as PNG."""
    from PIL import Image

    for part in (kind, f"{kind}_mask"):
        (folder / part).mkdir(exist_ok=True)
    Image.fromarray(image).save(folder / kind / f"{name}.jpg", quality=quality)
    write_images(
        [(folder / f"{kind}_mask" / f"{name}.png", np.where(mask, 255, 0).astype(np.uint8))]
    )
