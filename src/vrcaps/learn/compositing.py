"""Rendered lesions in real images without lesions, with exact masks.

A view is rendered with its lesions and again without them, as a clean twin. The quotient of both
linear radiances states how the lesion changes the color and the shading of the wall, and contains
neither the light nor the wall of the renderer (the quotient image of Shashua and Riklin-Raviv,
TPAMI 23, 2001). A real image is multiplied by it in linear light, so the lesion has the light, the
color cast and the exposure of that image.

Blood dissolved in fluid has no outline on the wall. `fluid_patch` draws it as a film of random
thickness with the transmittance of blood; bile and shadow are drawn likewise, for images without a
lesion.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
import scipy

from vrcaps.core import rng
from vrcaps.core.color import linear_from_srgb, luminance, srgb_from_linear
from vrcaps.core.errors import InputError, require
from vrcaps.core.files import atomic_folder
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.learn.picture_border import tissue_of
from vrcaps.lesion.focal import BLOOD_EXTINCTION, FRESH, OLD
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import NORMAL, FrameSequence, lesion_instances

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

Fluid = Literal["blood", "bile", "shadow"]
Pair: TypeAlias = tuple[FrameSequence, FrameSequence]
"""A recording with lesions and its clean twin."""
_RATIOS = (1.0 / 64.0, 2.0)
"""Limits of a quotient: black wall and highlights have no meaningful one."""
_DARKEST = 1e-3
"""Minimum radiance of the clean view, relative to its 95 % quantile; darker pixels keep a quotient
of 1."""
_FEATHER = 0.012
"""Width of the transition within a mask, relative to the longer side of the image."""
_WALL = np.array([0.52, 0.29, 0.19])
"""Linear reflectance of the mucosa below a film of fluid: mean of the recorded small bowel."""
_BILE = np.array([0.30, 0.26, 0.03]), np.array([0.3, 0.6, 6.0]) / MM
"""Reflectance of a thick layer and two-way optical density per length of bile; fitted visually."""
_SHADOW = np.array([0.02, 0.012, 0.008]), np.array([1.5, 2.0, 2.4]) / MM
"""The same of an unlit hollow, as if light were absorbed; fitted visually."""
_VISIBLE = 0.7
"""Optical density in green from which a film of blood belongs to the mask: half the light."""
_THICKNESS = (0.15 * MM, 1.2 * MM)
"""Range of the maximum thickness of a film of fluid [m]."""
_AREA = (0.02, 1.0)
"""Range of the fraction of an image that fluid covers."""
_SCALE = (0.75, 2.2)
"""Range of the magnification of a rendered view relative to the real image."""
_QUALITY = (80, 95)
"""Range of the JPEG quality of written images."""
_MAX_GAIN = 3.0
"""Maximum gain by which automatic exposure compensates darker images."""
_DRAWS = 8
"""Draws of a position of a lesion until it lies in the tissue."""


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
    wall: Float[np.ndarray, " 3"] = field(default_factory=lambda: _WALL)


@dataclass(frozen=True)
class CompositeSettings:
    """Settings of a folder of composites.

    Attributes:
        count: Number of images.
        normal: Fraction of images without a lesion; half of them with bile or shadow.
        fluid: Fraction of the images with a lesion that show blood in fluid instead of a rendered
            lesion, and a fourth of which show both.
        min_fraction: Minimum fraction of the image that a lesion covers.
        seed: Random seed.
    """

    count: int = 1000
    normal: float = 0.4
    fluid: float = 0.4
    min_fraction: float = 0.004
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.count >= 1, "count", self.count, "1 or more")
        require(self.seed >= 0, "seed", self.seed, "0 or more")
        for name in ("normal", "fluid", "min_fraction"):
            value = getattr(self, name)
            require(0.0 <= value <= 1.0, name, value, "0 to 1")


def lesion_pairs(sequences: Sequence[FrameSequence]) -> list[Pair]:
    """Pair recordings with lesions with their clean twins: same scenario, without the lesions.

    Raises:
        InputError: If there is no pair, or a recording lacks a channel.
    """
    pairs: dict[str, dict[bool, FrameSequence]] = defaultdict(dict)
    for one in sequences:
        if one.episode is None:
            raise InputError(f"{one.name} is not a recording. Give one of `vrcaps dataset make`.")
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


def fluid_patch(
    height: int, width: int, draw: np.random.Generator, fluid: Fluid = "blood"
) -> LesionPatch:
    """Return a film of fluid of random shape, thickness and age.

    Light passes the film twice: the reflectance of the wall w becomes b + (w − b) exp(−t e), where
    b is the reflectance of a thick layer, t the thickness and e its optical density per length
    (as `under_blood`). The mask is where blood absorbs half of the green light; empty for others.
    """
    thickness = _film(height, width, draw)
    if fluid == "blood":
        body, extinction = FRESH + (OLD - FRESH) * draw.uniform() ** 2, BLOOD_EXTINCTION
    else:
        body, extinction = _BILE if fluid == "bile" else _SHADOW
    dense = thickness[..., None] * extinction
    body = body / _WALL * draw.uniform(0.7, 1.6)
    ratio = np.clip(body + (1.0 - body) * np.exp(-dense), *_RATIOS)
    mask = (dense[..., 1] > _VISIBLE) & (fluid == "blood")
    return LesionPatch(ratio, mask, "bleeding")


def _film(height: int, width: int, draw: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Thickness of a film of random shape [m]: clouds, or streaks along level lines."""
    side = max(height, width)

    def noise(scale: float) -> Float[np.ndarray, "h w"]:
        values = scipy.ndimage.gaussian_filter(draw.normal(size=(height, width)), scale * side)
        return values / max(float(values.std()), 1e-12)

    shape = noise(draw.uniform(0.08, 0.25)) + 0.12 * noise(0.04)
    if draw.uniform() < 0.3:
        shape = -np.abs(shape) + 0.4 * noise(0.12)
    area = float(np.exp(draw.uniform(*np.log(_AREA))))
    level = float(np.quantile(shape, 1.0 - area)) if area < 0.95 else float(shape.min()) - 0.5
    soft = float(np.exp(draw.uniform(np.log(0.1), np.log(1.5))))
    maximum = float(np.exp(draw.uniform(*np.log(_THICKNESS))))
    within = smoothstep((shape - level) / soft)
    return maximum * within * np.clip(1.0 + 0.25 * noise(0.05), 0.2, 2.0)


def composite(
    image: UInt8[np.ndarray, "h w 3"], patch: LesionPatch, *, hue: float = 0.0
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Composite a lesion into an image.

    Linear light is multiplied by the quotient to the power of a weight, which increases from 0 at
    the mask's outline to 1 within 1.2 % of the longer side. Pixels outside the mask are unchanged.

    Args:
        image: Image without a lesion.
        patch: Change by the lesion, of the same size.
        hue: How far an opaque lesion keeps its rendered hue, 0 to 1. With 0 the hue of the wall,
            relative to that of the rendered one, is taken for a color cast of the camera, with 1
            for the wall's own, which an opaque lesion hides.

    Returns:
        The image, and the mask of the lesion: that of the patch within the field of view.

    Raises:
        InputError: If the sizes differ.
    """
    size = image.shape[:2]
    require(patch.mask.shape == size, "size of the patch", patch.mask.shape, f"{size}, the image's")
    tissue = tissue_of(image)
    mask = patch.mask & tissue
    if not mask.any():
        return image, mask
    own = linear_from_srgb(image)[tissue].mean(axis=0)
    cast = (own / own.sum()) / (patch.wall / patch.wall.sum())
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
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, int]:
    """Write a folder of composites: images and masks by kind of lesion, and normal ones.

    The folders `bleeding` and `bleeding_mask`, and so on, are those that `images:` reads, for
    segmentation of any lesion and for classification. Normal images are treated alike, so neither
    compression nor exposure is a sign of a lesion. The same arguments give the same files.

    Args:
        pairs: Recordings and clean twins, see `lesion_pairs`.
        images: Real images without lesions.
        out: Folder to create.
        settings: Settings; None for the defaults.
        progress: Called with the number of written images and the total.

    Returns:
        Number of images by kind.

    Raises:
        InputError: If the folder exists, an image cannot be read, or no lesion is visible.
    """
    settings = settings or CompositeSettings()
    frames = [(one, index) for one in images for index in range(len(one))]
    views = [(*pair, index) for pair in pairs for index in range(len(pair[0]))]
    if not frames or not views:
        raise InputError(f"{len(views)} views and {len(frames)} images are given. Allowed: 1 each.")
    counts: dict[str, int] = defaultdict(int)
    with atomic_folder(out) as partial:
        for index in range(settings.count):
            draw = rng.stream(settings.seed, "learn/composite", index)
            sequence, frame = frames[int(draw.integers(len(frames)))]
            image = sequence.image("rgb", frame)
            made, mask, kind = _drawn(image, views, settings, draw)
            made = _exposed(made, image, draw)
            _write(partial, f"{index:06d}", made, mask, kind, int(draw.integers(*_QUALITY)))
            counts[kind] += 1
            progress(index + 1, settings.count)
    return dict(counts)


def _drawn(
    image: UInt8[np.ndarray, "h w 3"],
    views: Sequence[tuple[FrameSequence, FrameSequence, int]],
    settings: CompositeSettings,
    draw: np.random.Generator,
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"], str]:
    """One image with a lesion or without, its mask and its kind."""
    height, width = image.shape[:2]
    nothing = np.zeros((height, width), bool)
    if draw.uniform() < settings.normal:
        if draw.uniform() < 0.5:
            fluid: Fluid = "bile" if draw.uniform() < 0.5 else "shadow"
            ratio = fluid_patch(height, width, draw, fluid).ratio
            image = _changed(image, ratio, tissue_of(image))
        return image, nothing, NORMAL
    way = draw.uniform()
    made, mask, kind = image, nothing, NORMAL
    for _ in range(_DRAWS):
        patches = []
        if way >= settings.fluid or way < 0.25 * settings.fluid:
            patch = rendered_patch(*views[int(draw.integers(len(views)))])
            patches = [] if patch is None else [placed(patch, height, width, draw)]
        if way < settings.fluid:
            patches.append(fluid_patch(height, width, draw))
        made, mask = image, nothing
        for patch in patches:
            made, added = composite(made, patch, hue=float(np.sqrt(draw.uniform())))
            mask, kind = mask | added, patch.kind
        if mask.mean() >= settings.min_fraction:
            return made, mask, kind
    return image, nothing, NORMAL


def _exposed(
    image: UInt8[np.ndarray, "h w 3"],
    before: UInt8[np.ndarray, "h w 3"],
    draw: np.random.Generator,
) -> UInt8[np.ndarray, "h w 3"]:
    """Image with a random part of the gain by which automatic exposure restores the mean light."""
    light, old = linear_from_srgb(image), linear_from_srgb(before)
    full = luminance(old).mean() / max(float(luminance(light).mean()), 1e-6)
    gain = float(np.clip(full, 1.0, _MAX_GAIN)) ** draw.uniform()
    return image if gain == 1.0 else srgb_from_linear(gain * light)


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
