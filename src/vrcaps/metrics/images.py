"""Image metrics: PSNR and SSIM in 64-bit floats, and color similarity in CIE L*a*b*."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.color import lab_from_srgb, linear_from_srgb
from vrcaps.core.errors import InputError, import_extra, require, require_one_shape

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8


_WINDOW_PX = 11
"""Side of SSIM's Gaussian window (sigma 1.5 px): images must not be smaller."""


def psnr(
    estimate: Float[np.ndarray, "h w *c"],
    truth: Float[np.ndarray, "h w *c"],
    *,
    data_range: float,
    crop: int = 0,
) -> float:
    """Peak signal-to-noise ratio 10 log₁₀(range² / MSE) [dB]; infinite for equal images.

    Args:
        estimate: Estimated image.
        truth: Original.
        data_range: Maximum minus minimum possible value: 255 for 8 bits, 1 for unit
            range.
        crop: Pixels to exclude at each edge; papers on super-resolution exclude the factor.

    Raises:
        InputError: If the shapes differ or no pixels are left.
    """
    d, t = _cropped(estimate, truth, crop)
    error = float(np.mean((d - t) ** 2))
    return float(10.0 * np.log10(data_range**2 / error)) if error > 0.0 else float("inf")


def ssim(
    estimate: Float[np.ndarray, "h w *c"],
    truth: Float[np.ndarray, "h w *c"],
    *,
    data_range: float,
    crop: int = 0,
) -> float:
    """Structural similarity, mean over channels (Wang et al., IEEE TIP 13(4), 2004).

    As in that paper: Gaussian window of 11 × 11 pixels with sigma 1.5, K1 = 0.01, K2 = 0.03,
    variances divided by the number of pixels; only pixels whose window lies inside count.

    Args:
        estimate: Estimated image.
        truth: Original.
        data_range: Maximum minus minimum possible value.
        crop: Pixels to exclude at each edge.

    Raises:
        InputError: If the shapes differ or the window does not fit.
    """
    structural_similarity = import_extra(
        "skimage.metrics", "learn", package="scikit-image"
    ).structural_similarity

    d, t = _cropped(estimate, truth, crop)
    require(
        min(d.shape[:2]) >= _WINDOW_PX, "size of the image", d.shape[:2], f"{_WINDOW_PX} px or more"
    )
    similarity: Any = structural_similarity(
        d,
        t,
        data_range=data_range,
        channel_axis=-1 if d.ndim == 3 else None,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(similarity)


def _cropped(
    estimate: np.ndarray, truth: np.ndarray, crop: int
) -> tuple[Float[np.ndarray, "h w *c"], Float[np.ndarray, "h w *c"]]:
    require_one_shape(estimate, truth)
    limit = (min(truth.shape[:2]) - 1) // 2
    require(0 <= crop <= limit, "crop", crop, f"0 to {limit} px")
    inner = slice(crop, -crop if crop else None)
    return np.asarray(estimate[inner, inner], float), np.asarray(truth[inner, inner], float)


CHANNELS = ("L", "a", "b")

_GRADIENT_STEP, _GRADIENT_BINS = 0.25, 240
"""Width [Lab units per pixel] and number of a histogram's bins; the last bin is open."""


_HIGHLIGHT = 0.45
"""Minimum linear value of all color channels of a highlight pixel."""


@dataclass(frozen=True)
class ImageColor:
    """Color statistics of one image in L*, a*, b*.

    Attributes:
        mean: Mean over its valid pixels.
        spread: Standard deviation over its valid pixels.
        gradients: Histogram of the gradient magnitude, in steps of 0.25 units per pixel; each
            row sums to 1.
    """

    mean: Float[np.ndarray, " 3"]
    spread: Float[np.ndarray, " 3"]
    gradients: Float[np.ndarray, "3 k"]


def image_color(rgb: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"]) -> ImageColor:
    """Color statistics of the valid pixels of an image.

    The gradient is by central differences, at pixels whose four neighbors are also valid.

    Raises:
        InputError: If no pixel has four valid neighbors.
    """
    if valid.shape != rgb.shape[:2]:
        raise InputError(f"The mask has shape {valid.shape}; allowed: {rgb.shape[:2]}.")
    lab = lab_from_srgb(rgb)
    across = 0.5 * (lab[1:-1, 2:] - lab[1:-1, :-2])
    down = 0.5 * (lab[2:, 1:-1] - lab[:-2, 1:-1])
    inner = valid[1:-1, 1:-1] & valid[1:-1, 2:] & valid[1:-1, :-2] & valid[2:, 1:-1]
    inner &= valid[:-2, 1:-1]
    if not inner.any():
        raise InputError("No pixel has four valid neighbors. Give a larger mask.")
    magnitude = np.hypot(across, down)[inner]
    bins = np.minimum((magnitude / _GRADIENT_STEP).astype(int), _GRADIENT_BINS - 1)
    counts = np.stack([np.bincount(channel, minlength=_GRADIENT_BINS) for channel in bins.T])
    values = lab[valid]
    return ImageColor(values.mean(axis=0), values.std(axis=0), counts / inner.sum())


def highlights(
    rgb: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"]
) -> tuple[float, int]:
    """Fraction of the valid pixels in highlights, and the number of highlights.

    In a highlight, the minimum of red, green and blue is at least 0.45 of white: mucosa reflects so
    little blue that only specular reflection, or overexposure, reaches this. A highlight is one
    connected component, by sides or corners.

    Raises:
        InputError: If the mask has another shape or no pixel.
    """
    from scipy import ndimage

    if valid.shape != rgb.shape[:2] or not valid.any():
        raise InputError(
            f"The mask has shape {valid.shape} and {int(valid.sum())} pixels set. Allowed: shape "
            f"{rgb.shape[:2]} and at least one pixel."
        )
    is_highlight = (linear_from_srgb(rgb).min(axis=-1) >= _HIGHLIGHT) & valid
    index = np.empty(valid.shape, np.int32)
    ndimage.label(is_highlight, np.ones((3, 3)), output=index)
    return float(is_highlight.sum() / valid.sum()), int(index.max())


@dataclass(frozen=True)
class ColorDistance:
    """Distance between two sets of images, for each of L*, a*, b* [Lab units].

    Attributes:
        mean: Wasserstein-1 distance between the images' means.
        spread: Wasserstein-1 distance between the images' spreads.
        gradient: Wasserstein-1 distance between the pooled histograms of gradients.
    """

    mean: Float[np.ndarray, " 3"]
    spread: Float[np.ndarray, " 3"]
    gradient: Float[np.ndarray, " 3"]


def color_distance(a: Sequence[ImageColor], b: Sequence[ImageColor]) -> ColorDistance:
    """Distance between two sets of images, with equal weight for each image of a set.

    Raises:
        InputError: If a set is empty.
    """
    if not a or not b:
        raise InputError(f"The sets have {len(a)} and {len(b)} images. Allowed: at least 1 each.")

    def apart(name: str) -> Float[np.ndarray, " 3"]:
        values = [np.stack([getattr(image, name) for image in side]) for side in (a, b)]
        return np.array([wasserstein(*(v[:, k] for v in values)) for k in range(3)])

    pooled = [np.mean([image.gradients for image in side], axis=0) for side in (a, b)]
    # In one dimension the distance is the area between the cumulative distributions.
    between = np.abs(np.cumsum(pooled[0] - pooled[1], axis=1)).sum(axis=1)
    return ColorDistance(apart("mean"), apart("spread"), between * _GRADIENT_STEP)


def wasserstein(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " m"]) -> float:
    """Wasserstein-1 distance between two samples: ∫ |F_a − F_b| over the values."""
    values = np.sort(np.concatenate([a, b]))
    at = values[:-1]
    fractions = [np.searchsorted(np.sort(side), at, side="right") / len(side) for side in (a, b)]
    return float(np.abs(fractions[0] - fractions[1]) @ np.diff(values))
