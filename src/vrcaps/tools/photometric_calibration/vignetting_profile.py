"""Vignetting profile of a camera, and color and brightness of the wall, from frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.tools.photometric_calibration.frames import Frames

if TYPE_CHECKING:
    from jaxtyping import Float

NUM_RINGS = 24
ENVELOPE = 0.9
"""Quantile of a ring's pixels that is its brightness, so that the dark lumen does not count."""
_NUM_PARTS = 8
_MAX_RISE = 0.3
"""Maximum k1 of a vignetting: with more, light would increase from the center, unlike any lens."""
_FEWEST = 200
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
    found = []
    for k in range(NUM_RINGS):
        values = relative[:, ring == k]
        values = values[np.isfinite(values)]
        if values.size >= _FEWEST:
            middle = 0.5 * (edges[k] + edges[k + 1])
            found.append((middle, float(np.quantile(values, ENVELOPE)), float(values.size)))
    return RadialProfile(*np.array(found).reshape(-1, 3).T)


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
        if exposed.sum() < _FEWEST:
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
