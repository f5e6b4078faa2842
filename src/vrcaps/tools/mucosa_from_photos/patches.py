"""Square patches of mucosa from photographs, without shading, at one scale and color."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import log_linear_from_srgb
from vrcaps.core.errors import InputError
from vrcaps.core.fields import check_fields
from vrcaps.tools.mucosa_from_photos.region import MIN_SIDE, Region, box_region, find_region
from vrcaps.tools.mucosa_from_photos.vessels import Vessels, find_vessels
from vrcaps.tools.photos import FieldOfView, field_of_view, fill

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.tools.photos import Photo

MAX_WIDTH = 1024
"""Maximum width of photographs [px]; wider ones are downsampled by an integer factor."""

_VESSEL_REACH = 1024  # side of the square in which vessels are searched [px]
_WORSE = 0.5  # maximum excess of unevenness of a further photograph's region over the best
_SMALLER = 0.7  # minimum ratio of its side to that of the best
_SLOW = 0.85  # fraction of the slow variation that is removed from a square
_BLEMISH = 3.7  # minimum distance of a rare mark from the mean [standard deviations]


@dataclass(frozen=True)
class PhotoAnalysis:
    """Analysis of one photograph.

    Attributes:
        photo: The photograph, downsampled if it was too wide.
        shrink: Downsampling factor.
        view: Its regions.
        filled: Logarithm of linear light, highlights filled in.
        flat: Logarithm of reflectance up to a constant, see `remove_shading`.
        region: The most uniform square.
        vessels: Detected vessels.
        mm_per_pixel: Scale of the downsampled photograph.
    """

    photo: Photo
    shrink: int
    view: FieldOfView
    filled: Float[np.ndarray, "h w 3"]
    flat: Float[np.ndarray, "h w 3"]
    region: Region
    vessels: Vessels
    mm_per_pixel: float

    @property
    def color(self) -> Float[np.ndarray, " 3"]:
        """Median logarithm of light in the region."""
        seen = self.view.usable[self.region.window]
        return np.median(self.filled[self.region.window][seen], axis=0)


@dataclass(frozen=True)
class PhotoScale:
    """Scale of the pixels; exactly one of the two is given.

    Attributes:
        mm_per_pixel: Size of a pixel on the wall.
        field_width_mm: Width of wall that the photograph's field shows.
    """

    mm_per_pixel: float | None = None
    field_width_mm: float | None = None

    def __post_init__(self) -> None:
        check_fields(self, of="PhotoScale")

    def of_field(self, width: int, shrink: int) -> float:
        """Millimeters per pixel for the width of the downsampled field [px]."""
        if self.mm_per_pixel is not None:
            return self.mm_per_pixel * shrink
        assert self.field_width_mm is not None
        return self.field_width_mm / width


def check_scale(scale: PhotoScale) -> None:
    """Check that the scale is given exactly once and is possible.

    Raises:
        InputError: If it is missing, given twice or impossible.
    """
    given = [value for value in (scale.mm_per_pixel, scale.field_width_mm) if value is not None]
    if len(given) != 1:
        raise InputError(
            "A photograph does not say its scale. Give one of --mm-per-pixel (size of a pixel on "
            "the wall) and --field-width-mm (width of wall across the picture, such as 30)."
        )
    if not (np.isfinite(given[0]) and 1e-4 < given[0] < 1e4):
        raise InputError(f"The scale is {given[0]} mm. Allowed: 0.0001 to 10000.")


def analyze_photo(
    photo: Photo,
    scale: PhotoScale,
    *,
    is_flat: bool = False,
    box: tuple[int, int, int, int] | None = None,
) -> PhotoAnalysis | None:
    """Analyze one photograph; None if it has no usable region.

    Args:
        photo: The photograph.
        scale: Scale of its pixels.
        is_flat: Whether it is a texture already, without border, highlights or shading.
        box: Left, top, width, height [px] of the region to use instead of searching.

    Raises:
        InputError: If the photograph is too small, or the box does not lie within it.
    """
    height, width = photo.rgb.shape[:2]
    if min(height, width) < MIN_SIDE:
        raise InputError(
            f"{photo.name} has {width} × {height} px: too few to make a texture from. "
            f"Allowed: {MIN_SIDE} or more on each side."
        )
    shrink = 1 if is_flat else -(-width // MAX_WIDTH)
    rgb = _shrunk(photo.rgb, shrink)
    view = _whole(rgb) if is_flat else field_of_view(rgb)
    usable = view.usable
    if usable.sum() < MIN_SIDE**2:
        return None
    filled = fill(log_linear_from_srgb(rgb), usable)
    region = find_region(filled, usable, view.width) if box is None else None
    if box is not None:
        region = box_region(tuple(n // shrink for n in box), usable.shape)  # type: ignore[arg-type]
    if region is None:
        return None
    flat = filled if is_flat else remove_shading(filled, usable, view.width)
    flat = flat - np.median(flat[region.window], axis=(0, 1))
    near = _around(region, usable.shape)
    vessels = _placed(find_vessels(flat[near], usable[near], view.width), near, usable.shape)
    return PhotoAnalysis(
        photo=type(photo)(photo.name, rgb, photo.sha256),
        shrink=shrink,
        view=view,
        filled=filled,
        flat=flat,
        region=region,
        vessels=vessels,
        mm_per_pixel=scale.of_field(view.width, shrink),
    )


def _around(region: Region, shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Rows and columns around a region's center, where its vessels are searched."""
    starts = [
        int(np.clip(at + (region.side - _VESSEL_REACH) // 2, 0, max(0, size - _VESSEL_REACH)))
        for at, size in zip((region.row, region.column), shape, strict=True)
    ]
    return tuple(slice(start, start + _VESSEL_REACH) for start in starts)


def _placed(vessels: Vessels, near: tuple[slice, ...], shape: tuple[int, ...]) -> Vessels:
    """Vessels of a crop, with their mask extended to the whole image."""
    mask = np.zeros(shape, bool)
    mask[near] = vessels.mask
    return replace(vessels, mask=mask)


def choose(sources: list[PhotoAnalysis], max_sources: int) -> list[PhotoAnalysis]:
    """The most even ones, best first, without those much less even or much smaller."""
    best = sorted(sources, key=lambda source: source.region.unevenness)[:max_sources]
    first = best[0]
    extent = first.region.side * first.mm_per_pixel
    return [
        source
        for source in best
        if source.region.unevenness <= first.region.unevenness + _WORSE
        and source.region.side * source.mm_per_pixel >= _SMALLER * extent
    ]


def source_patches(
    chosen: list[PhotoAnalysis], *, keep_vessels: bool
) -> tuple[list[Float[np.ndarray, "s s 3"]], list[Bool[np.ndarray, "s s"]]]:
    """Patches of one size, scale and color for quilting, and masks of their filled-in pixels.

    Highlights, rare marks (whose repetition would show) and, unless kept, vessels are filled in.
    Variation slower than a patch, which would turn into a lattice, is reduced. Each channel of each
    square is scaled to the mean standard deviation of all (Reinhard et al. 2001, Color transfer
    between images, in logarithms of light).

    Args:
        chosen: Analyzed photographs; the first determines the scale.
        keep_vessels: Whether vessels are kept.
    """
    parts, masks = [], []
    for source in chosen:
        window = source.region.window
        doubtful = ~source.view.usable[window]
        part = source.flat[window]
        hidden = doubtful if keep_vessels else doubtful | _grown(source.vessels.mask[window])
        part = fill(part, ~hidden) if not hidden.all() else part
        marks = _blemishes(part)
        part = fill(part, ~marks)
        zoom = source.mm_per_pixel / chosen[0].mm_per_pixel
        if abs(zoom - 1.0) > 0.02:
            part = np.asarray(scipy.ndimage.zoom(part, (zoom, zoom, 1.0), order=1))
            doubtful = (
                np.asarray(scipy.ndimage.zoom((doubtful | marks).astype(float), zoom, order=1))
                > 0.5
            )
        else:
            doubtful = doubtful | marks
        parts.append(_high_pass(part - part.mean(axis=(0, 1))))
        masks.append(doubtful)
    side = min(len(part) for part in parts)
    spread = np.mean([part.std(axis=(0, 1)) for part in parts], axis=0)
    even = [
        (part * np.clip(spread / np.maximum(part.std(axis=(0, 1)), 1e-6), 0.6, 1.6))[:side, :side]
        for part in parts
    ]
    return [part.astype(np.float32) for part in even], [mask[:side, :side] for mask in masks]


def _high_pass(part: Float[np.ndarray, "s s 3"]) -> Float[np.ndarray, "s s 3"]:
    """Remove most of the variation slower than an eighth of the side."""
    sigma = len(part) / 8.0
    return part - _SLOW * scipy.ndimage.gaussian_filter(part, (sigma, sigma, 0.0), mode="reflect")


def _shrunk(rgb: np.ndarray, factor: int) -> np.ndarray:
    """Average over blocks of pixels."""
    if factor == 1:
        return rgb
    height, width = (n // factor * factor for n in rgb.shape[:2])
    blocks = rgb[:height, :width].reshape(height // factor, factor, width // factor, factor, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def _whole(rgb: np.ndarray) -> FieldOfView:
    shape = rgb.shape[:2]
    return FieldOfView(np.ones(shape, bool), np.zeros(shape, bool), np.zeros(shape, bool), shape[1])


def _grown(mask: np.ndarray) -> np.ndarray:
    return scipy.ndimage.binary_dilation(mask, iterations=1)


def _blemishes(part: Float[np.ndarray, "s s 3"]) -> Bool[np.ndarray, "s s"]:
    """Detect marks so rare in a square that their repetition would be noticed."""
    tints = np.dstack([part, part[..., 0] - part[..., 1], part[..., 1] - part[..., 2]])
    smooth = scipy.ndimage.gaussian_filter(tints, (0.7, 0.7, 0.0))
    off = np.abs(smooth - np.median(smooth, axis=(0, 1)))
    spread = 1.4826 * np.median(off, axis=(0, 1))
    marks = (off > _BLEMISH * np.maximum(spread, 1e-6)).any(axis=2)
    return scipy.ndimage.binary_dilation(marks, iterations=2)


SHADING_GRAIN = 1 / 16
"""Standard deviation of the shading low-pass, as a fraction of the field's width."""


def remove_shading(
    log_light: Float[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"], width: int
) -> Float[np.ndarray, "h w 3"]:
    """Remove shading by homomorphic filtering: log R = log I − low-pass(log I).

    Light and reflectance multiply, so in logarithms they add (Oppenheim et al. 1968; a one-scale
    retinex, Jobson et al. 1997). The low-pass is a Gaussian over known pixels alone (normalized
    convolution), per channel, since light after several bounces in the gut is redder. The mean of
    the known pixels becomes 0.

    Args:
        log_light: Logarithm of linear light.
        known: Pixels that show the wall.
        width: Width of the field [px].
    """
    sigma = SHADING_GRAIN * width
    weight = scipy.ndimage.gaussian_filter(known.astype(np.float32), sigma, mode="reflect")
    weight = np.maximum(weight, 1e-6)
    flat = np.empty_like(log_light)
    for channel in range(3):
        part = np.where(known, log_light[..., channel], 0.0)
        flat[..., channel] = log_light[..., channel] - (
            scipy.ndimage.gaussian_filter(part, sigma, mode="reflect") / weight
        )
    return flat - flat[known].mean(axis=0)
