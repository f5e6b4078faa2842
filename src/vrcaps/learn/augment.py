"""Random changes of images.

Augmentation of training samples: crops, flips, exposure, white balance and gamma. For composites:
films of fluid in front of the wall, and the processing of a camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import numpy as np

from vrcaps.core.color import linear_from_srgb, luminance, srgb_from_linear
from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.learn.picture_border import tissue_of
from vrcaps.learn.task import Sample
from vrcaps.lesion.focal import BLOOD_EXTINCTION, FRESH, OLD

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8
    from numpy.typing import NDArray

Fluid = Literal["blood", "bile", "shadow", "murky"]
WALL = np.array([0.52, 0.29, 0.19])
"""Linear reflectance of the mucosa: mean of the recorded small bowel."""
_JITTER = Range(1.0, 10.0)
_BROWN = np.array([0.10, 0.026, 0.010]), np.array([1.6, 6.0, 9.0]) / MM
"""Reflectance of a thick layer and two-way optical density per length of brown blood; fitted
visually, like the following."""
_OTHERS = {
    "bile": (np.array([0.30, 0.26, 0.03]), np.array([0.3, 0.6, 6.0]) / MM),
    "shadow": (np.array([0.02, 0.012, 0.008]), np.array([1.5, 2.0, 2.4]) / MM),
    "murky": (np.array([0.05, 0.022, 0.025]), np.array([2.0, 3.0, 3.0]) / MM),
}
"""The same for fluids without blood, and for an unlit cavity modeled as absorption."""
_VISIBLE = 0.7
"""Optical density in green from which a film of blood is in the mask: half the light is
absorbed."""
_LIGHT_BLUR = 0.03
"""Standard deviation of the blur that separates illumination from texture, relative to the longer
side of the image."""


@dataclass(frozen=True)
class Augmentation:
    """Random changes of training samples. Factors of color are drawn log-uniformly.

    Attributes:
        exposure_jitter: Maximum change of exposure, as a factor: 1.3 is ± 30 %.
        color_jitter: Maximum change of each color channel, as a factor.
        gamma_jitter: Maximum exponent. With 1 for all five jitters, colors are not changed.
        min_crop: Minimum side of a random crop, relative to the image; 1 is the whole image.
        tone_jitter: Maximum slope in the dark of a tone curve that compresses highlights and keeps
            white; 1 is none.
        shading_jitter: Maximum ratio of the light in the middle of an image to that in its corners,
            as by another lens or LEDs; 1 is none.
    """

    exposure_jitter: Annotated[float, _JITTER] = 1.3
    color_jitter: Annotated[float, _JITTER] = 1.25
    gamma_jitter: Annotated[float, _JITTER] = 1.3
    min_crop: Annotated[float, Range(above=0.0, max=1.0)] = 0.6
    tone_jitter: Annotated[float, _JITTER] = 1.0
    shading_jitter: Annotated[float, _JITTER] = 1.0

    def __post_init__(self) -> None:
        check_fields(self)

    def crop(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Crop a random square from a sample and resize it to the sample's size.

        Args:
            sample: `image`, and maps [s s ...], which are resampled by nearest neighbor.
            rng: Random generator for the crop.
        """
        from PIL import Image

        size = sample["image"].shape[0]
        side = size * rng.uniform(self.min_crop, 1.0)
        left, top = rng.uniform(0.0, size - side, 2)
        centers = (np.arange(size) + 0.5) * side / size
        part = np.ix_((top + centers).astype(int), (left + centers).astype(int))
        box = (left, top, left + side, top + side)
        image = Image.fromarray(sample["image"])
        large = np.asarray(image.resize((size, size), Image.Resampling.BILINEAR, box=box))
        maps = {
            name: np.ascontiguousarray(array[part])
            if np.shape(array)[:2] == (size, size)
            else array
            for name, array in sample.items()
        }
        return maps | {"image": large}

    def recolor(
        self, image: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Apply a random shading, exposure, white balance, gamma and tone curve to an image."""
        exposure = self.exposure_jitter ** rng.uniform(-1.0, 1.0)
        gain = exposure * self.color_jitter ** rng.uniform(-1.0, 1.0, 3)
        gamma = self.gamma_jitter ** rng.uniform(-1.0, 1.0)
        if self.shading_jitter > 1.0:
            image = with_shading(image, self.shading_jitter ** rng.uniform(0.0, 1.0))
        if self.tone_jitter > 1.0:
            image = with_tone(image, self.tone_jitter ** rng.uniform(0.0, 1.0))
        return with_gain(image, gain, gamma)


def flip(sample: Sample, axis: int) -> Sample:
    """Flip all maps of a sample along columns (axis 1) or rows (axis 0)."""
    return _with_maps(sample, lambda array: np.flip(array, axis))


def transpose(sample: Sample) -> Sample:
    """Exchange rows and columns of all maps of a sample."""
    return _with_maps(sample, lambda array: np.swapaxes(array, 0, 1))


def random_flip(sample: Sample, rng: np.random.Generator) -> Sample:
    """Flip a sample along rows, columns, both or neither, at random."""
    for axis in (0, 1):
        if rng.random() < 0.5:
            sample = flip(sample, axis)
    return sample


def with_gain(
    image: UInt8[np.ndarray, "h w 3"], gain: Float[np.ndarray, " 3"], gamma: float
) -> UInt8[np.ndarray, "h w 3"]:
    """Apply a factor per color channel and a gamma to an image."""
    table = np.arange(256)[:, None] / 255.0
    changed = np.clip(255.0 * gain * table**gamma + 0.5, 0, 255).astype(np.uint8)
    return np.stack([changed[image[..., k], k] for k in range(3)], axis=-1)


def with_tone(image: UInt8[np.ndarray, "h w 3"], slope: float) -> UInt8[np.ndarray, "h w 3"]:
    """Apply a tone curve in linear light: x to a x / (1 + (a - 1) x), with the slope a at 0.

    Black and white stay; dark colors are a times as bright, and highlights are compressed, as by
    processors of endoscopes. It is L / (1 + L) (Reinhard et al., ACM TOG 21, 2002, eq. 3) for
    L = (a - 1) x, scaled to 1 at white.
    """
    linear = linear_from_srgb(np.arange(256, dtype=np.uint8))
    return srgb_from_linear(slope * linear / (1.0 + (slope - 1.0) * linear))[image]


def with_shading(image: UInt8[np.ndarray, "h w 3"], ratio: float) -> UInt8[np.ndarray, "h w 3"]:
    """Darken an image towards its corners, in linear light, by exp(−r² ln `ratio`).

    The distance r from the middle is 1 in the corners.
    """
    rows, columns = (np.linspace(-1.0, 1.0, size) for size in image.shape[:2])
    factor = ratio ** (-0.5 * (rows[:, None] ** 2 + columns**2))
    return srgb_from_linear(linear_from_srgb(image) * factor[..., None])


def _with_maps(sample: Sample, change: Callable[[NDArray], NDArray]) -> Sample:
    return {
        name: np.array(change(array), order="C") if getattr(array, "ndim", 0) >= 2 else array
        for name, array in sample.items()
    }


@dataclass(frozen=True)
class FluidFilm:
    """Film of fluid in front of the wall.

    Attributes:
        body: Linear reflectance of a thick layer [3].
        density: Two-way optical density [h w 3].
        mask: Mask of the lesion [h w]; empty without blood.
    """

    body: Float[np.ndarray, " 3"]
    density: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]

    def over(
        self, light: Float[np.ndarray, "h w 3"], illumination: Float[np.ndarray, "h w 3"]
    ) -> Float[np.ndarray, "h w 3"]:
        """Light of a scene behind the film: b + (L − b) exp(−d), as in `under_blood`.

        Args:
            light: Linear light L without the film.
            illumination: Light of a white wall; b is its product with the film's reflectance.
        """
        own = self.body * illumination
        return own + (light - own) * np.exp(-self.density)


def illumination_of(image: UInt8[np.ndarray, "h w 3"], hue: float) -> Float[np.ndarray, "h w 3"]:
    """Linear light of a white wall in the position of the wall, without its texture [h w 3].

    Args:
        image: Image of the wall.
        hue: Whether the mean hue of the image is that of the wall (1) or a color cast of light and
            camera (0), or a value between.

    Raises:
        InputError: If `hue` is not from 0 to 1.
    """
    from scipy.ndimage import gaussian_filter

    require(0.0 <= hue <= 1.0, "hue", hue, "0 to 1")
    tissue, light = tissue_of(image), linear_from_srgb(image)
    blur = _LIGHT_BLUR * max(tissue.shape)
    weight = np.maximum(gaussian_filter(tissue.astype(float), blur), 1e-3)
    level = gaussian_filter(luminance(light) * tissue, blur) / weight
    own = light[tissue].mean(axis=0) if tissue.any() else WALL
    cast = np.clip((own / max(float(own.sum()), 1e-9)) / (WALL / WALL.sum()), 0.1, 10.0)
    return (level / luminance(WALL))[..., None] * cast ** (1.0 - hue)


def fluid_film(
    image: UInt8[np.ndarray, "h w 3"], draw: np.random.Generator, fluid: Fluid = "blood"
) -> FluidFilm:
    """Return a film of fluid of random form, thickness and color.

    Blood is fresh, clotted or brown, thick or dilute; its mask is where it absorbs half of the
    green light.

    Args:
        image: Image of the wall; fluid pools in its dark folds.
        draw: Random generator.
        fluid: Fluid; all but blood have an empty mask.

    Raises:
        UnknownNameError: If the fluid is unknown.
    """
    if fluid not in get_args(Fluid):
        raise UnknownNameError("fluid", fluid, get_args(Fluid))
    if fluid != "blood":
        body, extinction = _OTHERS[fluid]
        thickness = _film(image, draw, (0.15, 1.2))
        body = body * draw.uniform(0.5, 1.6) * np.exp(draw.uniform(-0.25, 0.25, 3))
        return FluidFilm(body, thickness[..., None] * extinction, np.zeros(image.shape[:2], bool))
    thickness = _film(image, draw, (0.07, 0.7))
    age, brown = draw.uniform() ** 1.5, draw.uniform() ** 2
    body = FRESH + (OLD - FRESH) * age
    body = body + (_BROWN[0] - body) * brown
    haze = draw.uniform(0.0, 0.012) if draw.uniform() < 0.5 else 0.0
    body = body * _log_uniform(draw, 0.6, 3.0) + haze
    density = thickness[..., None] * (BLOOD_EXTINCTION + (_BROWN[1] - BLOOD_EXTINCTION) * brown)
    return FluidFilm(body, density, density[..., 1] > _VISIBLE)


def hemorrhage(image: UInt8[np.ndarray, "h w 3"], draw: np.random.Generator) -> FluidFilm:
    """Return hemorrhagic mucosa: spots and streaks of blood in a region of reddened mucosa.

    The mask is the region.
    """
    from scipy.ndimage import gaussian_filter

    form, level = _form(image, draw, (0.05, 0.95))
    within = smoothstep((form - level) / _log_uniform(draw, 0.2, 2.0))
    fine = _log_uniform(draw, 0.005, 0.025) * max(form.shape)
    long = fine * _log_uniform(draw, 1.0, 5.0)
    spots = gaussian_filter(draw.normal(size=form.shape), (long, fine))
    spots = spots / max(float(spots.std()), 1e-12)
    spots = smoothstep((spots - np.quantile(spots, 1.0 - draw.uniform(0.02, 0.4))) / 0.5)
    uneven = np.clip(1.0 + 0.35 * _noise(form.shape, 0.04, draw), 0.2, 2.0)
    reddened = _log_uniform(draw, 0.03, 0.15) * uneven
    thickness = within * (reddened + draw.uniform(0.05, 0.4) * spots) * MM
    body = (FRESH + (OLD - FRESH) * draw.uniform()) * draw.uniform(0.7, 2.0)
    return FluidFilm(body, thickness[..., None] * BLOOD_EXTINCTION, within > 0.4)


def _film(
    image: UInt8[np.ndarray, "h w 3"], draw: np.random.Generator, maximum: tuple[float, float]
) -> Float[np.ndarray, "h w"]:
    """Thickness of a film of random form [m], with a maximum in a range [mm]."""
    form, level = _form(image, draw, (0.02, 1.0))
    thickest = _log_uniform(draw, *maximum) * MM
    soft = _log_uniform(draw, 0.25, 4.0)
    within = smoothstep((form - level) / soft) ** (1.0 if draw.uniform() < 0.5 else 2.0)
    return thickest * within * np.clip(1.0 + 0.25 * _noise(form.shape, 0.05, draw), 0.2, 2.0)


def _form(
    image: UInt8[np.ndarray, "h w 3"], draw: np.random.Generator, area: tuple[float, float]
) -> tuple[Float[np.ndarray, "h w"], float]:
    """Random function with a standard deviation of 1, and the level above which there is fluid.

    Fluid forms clouds, pools in dark folds, streaks, or a pool at one side of the image.
    """
    shape, tissue = image.shape[:2], tissue_of(image)
    form = _noise(shape, _log_uniform(draw, 0.05, 0.4), draw) + 0.12 * _noise(shape, 0.04, draw)
    way = draw.uniform()
    if way < 0.3:
        form = draw.uniform(0.3, 1.0) * form + draw.uniform(0.5, 1.5) * _darkness(image, tissue)
    elif way < 0.45:
        form = -np.abs(form) + 0.4 * _noise(shape, 0.12, draw)
    elif way < 0.7:
        angle = draw.uniform(0.0, 2.0 * np.pi)
        row, column = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
        slope = column * np.cos(angle) + row * np.sin(angle)
        form = draw.uniform(0.3, 1.0) * form + 2.5 * slope
    form = form / max(float(form.std()), 1e-9)
    covered = _log_uniform(draw, *area)
    inside = form[tissue] if tissue.any() else form
    level = np.quantile(inside, 1.0 - covered) if covered < 0.95 else form.min() - 0.5
    return form, float(level)


def _noise(
    shape: tuple[int, ...], scale: float, draw: np.random.Generator
) -> Float[np.ndarray, "h w"]:
    """Smooth noise with a standard deviation of 1; its scale is relative to the longer side."""
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(draw.normal(size=shape), scale * max(shape))
    return values / max(float(values.std()), 1e-12)


def _darkness(
    image: UInt8[np.ndarray, "h w 3"], tissue: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Negative logarithm of the blurred luminance, in standard deviations within the tissue."""
    from scipy.ndimage import gaussian_filter

    light = gaussian_filter(luminance(linear_from_srgb(image)), _LIGHT_BLUR * max(tissue.shape))
    dark = -np.log(light + 0.01)
    inside = dark[tissue] if tissue.any() else dark
    return np.clip((dark - inside.mean()) / max(float(inside.std()), 1e-6), -2.5, 2.5)


def _log_uniform(draw: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(draw.uniform(np.log(low), np.log(high))))


def photographed(
    light: Float[np.ndarray, "h w 3"],
    before: UInt8[np.ndarray, "h w 3"],
    draw: np.random.Generator,
) -> UInt8[np.ndarray, "h w 3"]:
    """Image of linear light by a random camera; the surroundings of the picture stay.

    A random part of the gain by which automatic exposure restores the mean light is applied; then,
    each at random, stray light, overexposure, saturation, contrast and blur.

    Args:
        light: Linear light.
        before: Image without the change of the scene, with the mean light to restore.
        draw: Random generator.
    """
    from scipy.ndimage import gaussian_filter

    tissue = tissue_of(before)[..., None]
    full = luminance(linear_from_srgb(before)).mean() / max(float(luminance(light).mean()), 1e-6)
    gain = float(np.clip(full, 1.0, 4.0)) ** draw.uniform()
    if draw.uniform() < 0.6 and tissue.any():
        light = light + draw.uniform(0.0, 0.06) * light[tissue[..., 0]].mean(axis=0)
    if draw.uniform() < 0.35:
        gain *= _log_uniform(draw, 1.0, 4.0)
    light = gain * light
    if draw.uniform() < 0.4:
        gray = luminance(light)[..., None]
        light = np.maximum(gray + draw.uniform(0.7, 1.15) * (light - gray), 0.0)
    if draw.uniform() < 0.4:
        exponent = draw.uniform(1.0, 1.3)
        light = np.clip(light, 0.0, 2.5) ** exponent * 1.3 ** (exponent - 1.0)
    if draw.uniform() < 0.25:
        blur = draw.uniform(0.004, 0.018) * max(before.shape)
        weight = np.maximum(gaussian_filter(tissue.astype(float), (blur, blur, 0.0)), 1e-6)
        light = gaussian_filter(light * tissue, (blur, blur, 0.0)) / weight
    return np.where(tissue, srgb_from_linear(light), before)
