"""Photometric models of a camera and their fits to frames: vignetting profile and noise.

The fit of the vignetting profile also estimates color and brightness of the wall.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import LINEAR
from vrcaps.tools.photometric_calibration.frames import Frames

if TYPE_CHECKING:
    from jaxtyping import Float

NUM_RINGS = 24
ENVELOPE = 0.9
"""Quantile of a ring's pixels that is its brightness, so that the dark lumen does not count."""
_NUM_PARTS = 8
_MAX_RISE = 0.3
"""Maximum k1 of a vignetting: with more, light would increase from the center, unlike any lens."""
_MIN_PIXELS = 200
"""Minimum number of pixels of all frames in a ring."""
_BRIGHT = (0.5, 0.95)
"""Quantiles of luminance between which mucosa shows its color: neither shadow nor highlight."""


@dataclass(frozen=True)
class RadialProfile:
    """Brightness by distance from the image center.

    Attributes:
        radius: Mean radii of the rings, in halves of the image's shorter side.
        brightness: Brightness of each ring, relative to the frames' own.
        count: Number of pixels of each ring.
    """

    radius: Float[np.ndarray, " k"]
    brightness: Float[np.ndarray, " k"]
    count: Float[np.ndarray, " k"]


def radial_profile(frames: Frames, center: tuple[float, float]) -> RadialProfile:
    """Compute the envelope of luminance over rings, each frame divided by its own mean.

    Args:
        frames: Frames of one camera.
        center: Column and row of the optical axis [px].
    """
    radius = _radius(frames, center)
    own = np.where(frames.field, frames.luminance, np.nan)
    own = own[frames.field.any(axis=(1, 2))]
    relative = own / np.nanmean(own, axis=(1, 2), keepdims=True)
    edges = np.linspace(0.0, radius.max(), NUM_RINGS + 1)
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, NUM_RINGS - 1)
    rings = []
    for k in range(NUM_RINGS):
        values = relative[:, ring == k]
        values = values[np.isfinite(values)]
        if values.size >= _MIN_PIXELS:
            middle = 0.5 * (edges[k] + edges[k + 1])
            rings.append((middle, float(np.quantile(values, ENVELOPE)), float(values.size)))
    return RadialProfile(*np.array(rings).reshape(-1, 3).T)


def _radius(frames: Frames, center: tuple[float, float]) -> Float[np.ndarray, "h w"]:
    """Distance of each pixel from the axis, in halves of the image's shorter side."""
    width, height = frames.size
    rows, columns = np.indices((height, width))
    return np.hypot(columns - center[0], rows - center[1]) / (0.5 * min(width, height))


@dataclass(frozen=True)
class VignettingProfile:
    """``1 + k1 ρ² + k2 ρ⁴`` of the light, ρ in halves of the image's shorter side.

    Attributes:
        k1: Coefficient of ρ².
        k2: Coefficient of ρ⁴.
        rim: Fraction of the light in the outermost ring.
        deviation: Standard deviation of `rim`, by leaving out parts of the frames.
    """

    k1: float
    k2: float
    rim: float
    deviation: float

    @property
    def is_clear(self) -> bool:
        """True if the frames darken towards the edge significantly."""
        return self.k1 <= _MAX_RISE and 1.0 - self.rim > 2.0 * self.deviation


def mean_transmission(
    vignetting: VignettingProfile, frames: Frames, center: tuple[float, float]
) -> float:
    """Mean transmission of a vignetting over the field; 1 if it is not clear."""
    if not vignetting.is_clear:
        return 1.0
    square = _radius(frames, center) ** 2
    transmission = np.maximum(1.0 + vignetting.k1 * square + vignetting.k2 * square**2, 0.0)
    return float(np.average(transmission, weights=frames.field.mean(axis=0)))


def fit_vignetting(
    frames: Frames,
    center: tuple[float, float],
    reference: tuple[Frames, tuple[float, float]] | None = None,
) -> VignettingProfile:
    """Fit the vignetting of a camera; deviation by a jackknife over eight parts of the frames.

    Args:
        frames: Frames of the camera.
        center: Column and row of its optical axis [px].
        reference: Frames without vignetting, such as rendered ones, and their center. Without them
            the light is assumed uniform, and the wall's own shading is attributed to the lens.
    """
    profile = radial_profile(frames, center)
    aim = None if reference is None else radial_profile(*reference)
    k1, k2, rim = _fitted(profile, aim)
    left_out = [_fitted(part, aim)[2] for part in _parts(frames, center)]
    variance = _jackknife(left_out)
    if reference is not None:
        variance += _jackknife([_fitted(profile, part)[2] for part in _parts(*reference)])
    return VignettingProfile(k1, k2, rim, float(np.sqrt(variance)))


def _fitted(profile: RadialProfile, reference: RadialProfile | None) -> tuple[float, float, float]:
    """Fit k1, k2 and the fraction of light in the outermost ring, where the light does not rise."""
    radius, brightness = profile.radius, profile.brightness
    if reference is not None:
        brightness = brightness / np.interp(radius, reference.radius, reference.brightness)
    weight = np.sqrt(profile.count / profile.count.max())
    square = radius**2

    def solve(terms: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " n"]:
        def residuals(x: np.ndarray) -> np.ndarray:
            return weight * (x[0] * (1.0 + terms @ x[1:]) - brightness)

        start = [float(brightness.mean()), -0.1, *[0.0] * (terms.shape[1] - 1)]
        return scipy.optimize.least_squares(residuals, start, loss="huber", f_scale=0.05).x[1:]

    k1, k2 = map(float, solve(np.column_stack([square, square**2])))
    if k1 < 0.0 and k1 + 2.0 * k2 * square[-1] > 0.0:
        # Zero slope at the rim: d/dρ (k1 ρ² + k2 ρ⁴) = 0.
        k1 = float(solve((square - 0.5 * square**2 / square[-1])[:, None])[0])
        k2 = -0.5 * k1 / square[-1]
    return k1, k2, float(1.0 + k1 * square[-1] + k2 * square[-1] ** 2)


def _parts(frames: Frames, center: tuple[float, float]) -> Iterator[RadialProfile]:
    """Profiles of the frames without every eighth, starting at each of the first eight."""
    count = len(frames.rgb)
    for k in range(min(_NUM_PARTS, count)):
        yield radial_profile(frames.part(np.arange(count) % _NUM_PARTS != k), center)


def _jackknife(values: list[float]) -> float:
    """Jackknife variance of an estimate from its leave-one-out values (Quenouille and Tukey)."""
    return (len(values) - 1) * float(np.var(values))


@dataclass(frozen=True)
class WallColor:
    """Color and brightness of the wall in frames.

    Attributes:
        red: Linear red over green of bright mucosa, the median of frames.
        blue: Linear blue over green.
        green: Median linear green within the field, the median of frames; 1 = white.
    """

    red: float
    blue: float
    green: float


def wall_color(frames: Frames) -> WallColor | None:
    """Color of pixels that are bright but neither saturated nor highlights; None without any."""
    logs = []
    for linear, luminance, exposed in zip(
        frames.linear, frames.luminance, frames.exposed, strict=True
    ):
        if exposed.sum() < _MIN_PIXELS:
            continue
        low, high = np.quantile(luminance[exposed], _BRIGHT)
        bright = exposed & (luminance >= low) & (luminance <= high)
        logs.append(np.log(linear[bright]).mean(axis=0))
    if not logs:
        return None
    ratios = np.median([log[[0, 2]] - log[1] for log in logs], axis=0)
    lit = [
        np.median(g[f]) for g, f in zip(frames.linear[..., 1], frames.field, strict=True) if f.any()
    ]
    red, blue = np.exp(ratios).tolist()
    return WallColor(red, blue, float(np.median(lit)))


BLOCK = 16
_STRIDE = 8
_FLATTEST = 0.1
"""Fraction of the blocks at a brightness that are treated as flat; texture adds variance."""
_CORRELATION = (1.0 + 2.0 * (4.0 / 6.0) ** 2 + 2.0 * (1.0 / 6.0) ** 2) ** 2
"""Sum of the squared autocorrelation of white noise after the filter [1 -2 1] along both axes."""
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

    A second difference along rows and columns, [1 -2 1] along both axes over 6, keeps the variance
    of white noise and removes shading (Immerkær, CVIU 64(2), 1996). Blocks of 16 px are sorted by
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
    values = []
    for k in range(_NUM_LEVELS):
        own = level == k
        if own.sum() < _FEWEST_BLOCKS:
            continue
        noise = float(np.quantile(variance[own], _FLATTEST)) / quantile
        if noise > 0.0:
            values.append((float(mean[own].mean()), noise, float(rounding[own].mean())))
    return np.array(values).reshape(-1, 3)


def _sums(images: Float[np.ndarray, "n h w"]) -> Float[np.ndarray, "n r c"]:
    """Sums over blocks."""
    total = np.pad(images.cumsum(axis=1).cumsum(axis=2), ((0, 0), (1, 0), (1, 0)))
    ends = total[:, BLOCK:, BLOCK:] - total[:, :-BLOCK, BLOCK:]
    sums = ends - total[:, BLOCK:, :-BLOCK] + total[:, :-BLOCK, :-BLOCK]
    return sums[:, ::_STRIDE, ::_STRIDE]
