"""How a camera's image darkens towards its edge, its colour and its brightness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from vrcaps.capsule.match.frames import Frames

if TYPE_CHECKING:
    from jaxtyping import Float

NUM_RINGS = 24
ENVELOPE = 0.9
"""Share of a ring's pixels below its brightness: the lumen's dark middle does not count."""
_INNER = 0.3
"""Radius of the disc that a frame's brightness is measured in, of half the shorter side."""
_FEWEST = 200
"""Pixels of all frames that a ring must have."""
_BRIGHT = (0.5, 0.95)
"""Quantiles of luminance between which mucosa shows its colour: neither shade nor glint."""


@dataclass(frozen=True)
class RadialProfile:
    """Brightness by distance from the image's centre.

    Attributes:
        radius: Middles of rings, in halves of the image's shorter side.
        brightness: Of each ring, relative to the frames' own.
        count: Pixels of each ring.
    """

    radius: Float[np.ndarray, " k"]
    brightness: Float[np.ndarray, " k"]
    count: Float[np.ndarray, " k"]


def radial_profile(frames: Frames, centre: tuple[float, float]) -> RadialProfile:
    """The envelope of luminance over rings, each frame divided by its own mean in the middle.

    Args:
        frames: Of one camera.
        centre: Column and row of the optical axis [px].
    """
    width, height = frames.size
    half = 0.5 * min(width, height)
    rows, columns = np.indices((height, width))
    radius = np.hypot(columns - centre[0], rows - centre[1]) / half
    own = np.where(frames.field, frames.luminance, np.nan)
    inner = np.broadcast_to(radius <= _INNER, own.shape)
    means = [np.nanmean(image[part]) if np.isfinite(image[part]).any() else np.nan
             for image, part in zip(own, inner, strict=True)]  # fmt: skip
    relative = own / np.array(means)[:, None, None]
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


def fit_vignetting(
    profile: RadialProfile, reference: RadialProfile | None = None
) -> tuple[float, float]:
    """k1, k2 of ``1 + k1 ρ² + k2 ρ⁴``, ρ in halves of the image's shorter side.

    Args:
        profile: Of the camera's frames.
        reference: Of frames without vignetting, such as rendered ones; None takes an even light,
            and then the wall's own shading counts as the lens's.

    Returns:
        Zeros if the frames do not darken towards the edge.
    """
    radius, brightness = profile.radius, profile.brightness
    if reference is not None:
        known = (radius >= reference.radius[0]) & (radius <= reference.radius[-1])
        radius, brightness = radius[known], brightness[known]
        brightness = brightness / np.interp(radius, reference.radius, reference.brightness)
    weight = np.sqrt(np.interp(radius, profile.radius, profile.count / profile.count.max()))
    square = radius**2

    def residuals(x: np.ndarray) -> np.ndarray:
        return weight * (x[0] * (1.0 + x[1] * square + x[2] * square**2) - brightness)

    start = [float(brightness.mean()), -0.1, 0.0]
    _, k1, k2 = map(float, least_squares(residuals, start, loss="huber", f_scale=0.05).x)
    share = 1.0 + k1 * square + k2 * square**2
    rises = share.max() > 1.05 or share[-1] > 0.99
    return (0.0, 0.0) if rises else (k1, k2)


@dataclass(frozen=True)
class WallColor:
    """Colour and brightness of the wall in frames.

    Attributes:
        red: Linear red over green of bright mucosa, the median of frames.
        blue: Linear blue over green.
        green: Mean linear green within the field, the median of frames; 1 = white.
    """

    red: float
    blue: float
    green: float


def wall_color(frames: Frames) -> WallColor | None:
    """Colour of what is bright but neither saturated nor a highlight; None if nothing is."""
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
    lit = [g[f].mean() for g, f in zip(frames.linear[..., 1], frames.field, strict=True) if f.any()]
    red, blue = np.exp(ratios).tolist()
    return WallColor(red, blue, float(np.median(lit)))
