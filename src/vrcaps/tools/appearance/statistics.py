"""Statistics of one view: exposure, color, radial profile, contrast, spectrum and highlights.

They need no network, so they check the distances between features of one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import lab_from_srgb, linear_from_srgb
from vrcaps.tools.appearance.image_set import DISC

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

STATISTICS = {
    "clipped": "pixels with a channel of 254 or 255 [%]",
    "lightness": "mean L*",
    "lightness spread": "standard deviation of L*",
    "rim": "mean L* beyond 0.75 of the disc's radius, minus the mean",
    "center": "mean L* within 0.2 of the disc's radius, minus the mean",
    "saturation": "mean HSV saturation",
    "ln B/G": "logarithm of mean linear blue over mean linear green",
    "hue": "angle of the mean a*, b* [deg]",
    "a* spread": "standard deviation of a*",
    "fine chroma": "log10 of the mean power of a* above 0.25 cycles per pixel",
    "slope": "slope of the log power spectrum of L*, 0.06 to 0.45 cycles per pixel",
    "ln R/G": "logarithm of mean linear red over mean linear green",
    "b* spread": "standard deviation of b*",
    "dark": "pixels below L* 15 [%]",
    "edges": "pixels with a gradient of L* above 8 per pixel [%]",
    "noise": "median absolute Laplacian of L*, over 4",
    "contrast 2 px": "standard deviation of L* between Gaussians of 1 and 2 px",
    "contrast 4 px": "standard deviation of L* between Gaussians of 2 and 4 px",
    "contrast 8 px": "standard deviation of L* between Gaussians of 4 and 8 px",
    "contrast 16 px": "standard deviation of L* between Gaussians of 8 and 16 px",
    "dark spread": "RMS distance of the darkest tenth from its center, over half the side",
    "highlights": "pixels more than 20 L* above their neighborhood (median of 9 px) [%]",
    "horizontal": "mean L* of the right half minus the left half, absolute",
    "vertical": "mean L* of the lower half minus the upper half, absolute",
}
"""Meaning of each statistic, in the order of `view_statistics`."""

GATES = (
    *("clipped", "lightness", "lightness spread", "center", "rim"),
    *("saturation", "ln B/G", "hue", "a* spread", "fine chroma", "slope"),
)
"""Statistics whose median should lie between the 10th and 90th percentile of real images."""


def view_statistics(view: UInt8[np.ndarray, "s s 3"]) -> Float[np.ndarray, " k"]:
    """Statistics of a view, in the order of `STATISTICS`."""
    lab = lab_from_srgb(view)
    values = {
        **_color(view, lab),
        **_profile(lab[..., 0]),
        **_texture(lab),
    }
    return np.array([values[name] for name in STATISTICS], float)


def _color(view: NDArray, lab: NDArray) -> dict[str, float]:
    largest, smallest = view.max(axis=-1).astype(float), view.min(axis=-1)
    red, green, blue = np.maximum(linear_from_srgb(view).mean(axis=(0, 1)), 1e-6)
    a, b = lab[..., 1], lab[..., 2]
    return {
        "clipped": 100.0 * float((largest >= 254).mean()),
        "saturation": float(((largest - smallest) / np.maximum(largest, 1.0)).mean()),
        "ln B/G": float(np.log(blue / green)),
        "ln R/G": float(np.log(red / green)),
        "hue": float(np.degrees(np.arctan2(b.mean(), a.mean()))),
        "a* spread": float(a.std()),
        "b* spread": float(b.std()),
    }


def _profile(lightness: NDArray) -> dict[str, float]:
    side = len(lightness)
    offset = np.arange(side) + 0.5 - 0.5 * side
    radius = np.hypot(offset[:, None], offset) / (0.5 * DISC)
    mean, half = float(lightness.mean()), side // 2
    darkest = np.argwhere(lightness <= np.quantile(lightness, 0.1))
    spread = np.sqrt(((darkest - darkest.mean(axis=0)) ** 2).sum(axis=1).mean())
    return {
        "lightness": mean,
        "lightness spread": float(lightness.std()),
        "rim": float(lightness[radius > 0.75].mean()) - mean,
        "center": float(lightness[radius < 0.2].mean()) - mean,
        "dark": 100.0 * float((lightness < 15.0).mean()),
        "dark spread": float(spread) / (0.5 * side),
        "horizontal": abs(float(lightness[:, half:].mean() - lightness[:, :half].mean())),
        "vertical": abs(float(lightness[half:].mean() - lightness[:half].mean())),
    }


def _texture(lab: NDArray) -> dict[str, float]:
    lightness, a = lab[..., 0], lab[..., 1]
    blurred = [scipy.ndimage.gaussian_filter(lightness, s) for s in (1, 2, 4, 8, 16)]
    gradient = np.hypot(*np.gradient(lightness))
    laplacian = scipy.ndimage.laplace(lightness)
    local = scipy.ndimage.median_filter(lightness, 9)
    contrast = {
        f"contrast {2 << k} px": float((fine - coarse).std())
        for k, (fine, coarse) in enumerate(pairwise(blurred))
    }
    return {
        "fine chroma": _fine_power(a),
        "slope": _spectral_slope(lightness),
        "edges": 100.0 * float((gradient > 8.0).mean()),
        "noise": float(np.median(np.abs(laplacian))) / 4.0,
        "highlights": 100.0 * float((lightness - local > 20.0).mean()),
        **contrast,
    }


def _frequencies(side: int) -> NDArray:
    """Frequency of each coefficient of a transform [cycles per pixel]."""
    axis = np.fft.fftfreq(side)
    return np.hypot(axis[:, None], axis)


def _fine_power(values: NDArray) -> float:
    power = np.abs(np.fft.fft2(values - values.mean())) ** 2
    return float(np.log10(power[_frequencies(len(values)) > 0.25].mean() + 1e-6))


def _spectral_slope(values: NDArray) -> float:
    window = np.hanning(len(values))
    power = np.abs(np.fft.fft2((values - values.mean()) * window[:, None] * window)) ** 2
    frequency = _frequencies(len(values))
    edges = np.linspace(0.06, 0.45, 16)
    bands = [power[(frequency >= low) & (frequency < high)].mean() for low, high in pairwise(edges)]
    middles = 0.5 * (edges[1:] + edges[:-1])
    return float(np.polyfit(np.log(middles), np.log(np.array(bands) + 1e-9), 1)[0])
