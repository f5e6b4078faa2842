"""Noise model of a camera from its frames: variance against brightness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import LINEAR
from vrcaps.tools.photometric_calibration.frames import Frames

if TYPE_CHECKING:
    from jaxtyping import Float

BLOCK = 16
_STRIDE = 8
_FLATTEST = 0.1
"""Fraction of the blocks of a brightness that are considered flat: texture adds variance."""
_CORRELATION = (1.0 + 2.0 * (4.0 / 6.0) ** 2 + 2.0 * (1.0 / 6.0) ** 2) ** 2
"""Sum of the squared autocorrelation of white noise after the filter [1 -2 1] both ways."""
MAX_ELECTRONS = 1e6
"""Full well above which noise is negligible."""
_NUM_LEVELS, _FEWEST_LEVELS, _FEWEST_BLOCKS = 12, 3, 30


@dataclass(frozen=True)
class NoiseModel:
    """``variance = brightness / full_well + (read_noise / full_well)²``; linear, 1 = white.

    Attributes:
        full_well: Electrons at white.
        read_noise: Standard deviation of the read noise [electrons].
        brightness: Brightness levels of the fit.
        variance: Variance at each level.
    """

    full_well: float
    read_noise: float
    brightness: Float[np.ndarray, " k"]
    variance: Float[np.ndarray, " k"]


def fit_noise(frames: Frames) -> NoiseModel | None:
    """Fit gain and read noise of the green channel; None if coding hides the noise.

    A second difference along rows and columns, [1 -2 1] both ways over 6, keeps the variance of
    white noise and removes shading (Immerkær, CVIU 64(2), 1996). Blocks of 16 px are sorted by
    brightness; at each level, the noise variance is the variance of the flattest tenth, divided by
    its expectation for uniform noise (chi-squared). The line is photon transfer's (Janesick 2007).
    The variance of rounding to 8 bits is subtracted; smaller noise cannot be measured. Demosaicing,
    resizing and JPEG reduce noise: the values describe the frames, not the sensor.
    """
    levels = _levels(*_blocks(frames))
    if len(levels) < _FEWEST_LEVELS:
        return None
    brightness, variance, rounding = levels.T

    def residuals(x: np.ndarray) -> np.ndarray:
        slope, offset = np.exp(x)
        return np.log((slope * brightness + offset) / variance)

    # Variances scatter in proportion to their value, hence the logarithm.
    start = np.log([np.median(variance / brightness), 0.3 * variance.min()])
    fit = scipy.optimize.least_squares(
        residuals, start, bounds=(-60.0, 0.0), loss="huber", f_scale=0.1
    )
    slope, offset = np.exp(fit.x).tolist()
    if np.median((slope * brightness + offset) / rounding) < 1.0 or slope < 1.0 / MAX_ELECTRONS:
        return None
    return NoiseModel(1.0 / slope, float(np.sqrt(offset)) / slope, brightness, variance)


def _blocks(frames: Frames) -> tuple[Float[np.ndarray, " m"], ...]:
    """Brightness, variance and rounding variance of all fully exposed blocks."""
    green = frames.linear[..., 1].astype(float)
    across = green[:, :, :-2] - 2.0 * green[:, :, 1:-1] + green[:, :, 2:]
    residual = (across[:, :-2] - 2.0 * across[:, 1:-1] + across[:, 2:]) / 6.0
    inner = (slice(None), slice(1, -1), slice(1, -1))
    exposed = _sums((~frames.exposed[inner]).astype(float)) == 0.0
    mean = _sums(green[inner])[exposed] / BLOCK**2
    square = _sums(residual**2)[exposed] / BLOCK**2
    code = frames.rgb[..., 1][inner].astype(float)
    step = np.gradient(LINEAR)[code.astype(int)]
    rounding = _sums(step**2 / 12.0)[exposed] / BLOCK**2
    return mean, square - rounding, rounding


def _levels(
    mean: np.ndarray, variance: np.ndarray, rounding: np.ndarray
) -> Float[np.ndarray, "k 3"]:
    """Brightness, noise variance and rounding variance at levels with enough blocks."""
    if len(mean) < _NUM_LEVELS:
        return np.zeros((0, 3))
    freedom = BLOCK**2 / _CORRELATION
    quantile = float(scipy.stats.chi2.ppf(_FLATTEST, freedom)) / freedom
    edges = np.quantile(mean, np.linspace(0.0, 1.0, _NUM_LEVELS + 1))
    level = np.clip(np.searchsorted(edges, mean, side="right") - 1, 0, _NUM_LEVELS - 1)
    found = []
    for k in range(_NUM_LEVELS):
        own = level == k
        if own.sum() < _FEWEST_BLOCKS:
            continue
        noise = float(np.quantile(variance[own], _FLATTEST)) / quantile
        if noise > 0.0:
            found.append((float(mean[own].mean()), noise, float(rounding[own].mean())))
    return np.array(found).reshape(-1, 3)


def _sums(images: Float[np.ndarray, "n h w"]) -> Float[np.ndarray, "n r c"]:
    """Sums over blocks."""
    total = np.pad(images.cumsum(axis=1).cumsum(axis=2), ((0, 0), (1, 0), (1, 0)))
    ends = total[:, BLOCK:, BLOCK:] - total[:, :-BLOCK, BLOCK:]
    sums = ends - total[:, BLOCK:, :-BLOCK] + total[:, :-BLOCK, :-BLOCK]
    return sums[:, ::_STRIDE, ::_STRIDE]
