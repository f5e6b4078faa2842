"""Image circle: the bright disc that a lens projects onto its sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

_NUM_DIRECTIONS = 360
_DARK_QUANTILE, _MAX_DARK = 0.01, 0.3
"""Level of the dark sensor outside the circle: this quantile, but at most this fraction of the
median code value, some 7 % of the light."""
_DARK_FRACTION = 0.08
"""Fraction of the way from the dark level to the median above which a pixel is lit."""
_NOISE = 10.0
"""Maximum value of the brightest channel of a dark sensor [of 255]: noise and coding."""
_STEP, _RIM = 0.25, 4.0
"""Sampling step along a direction, and width of the transition from dark to lit [px]."""
_MIN_FRACTION = 0.1
"""Minimum fraction of the directions that must show the edge for a circle to be fitted."""
_MAX_SCATTER = 0.03
"""Maximum median distance of the edge from the circle, as a fraction of its radius."""


@dataclass(frozen=True)
class ImageCircle:
    """Edge of the lit part of an image.

    Attributes:
        cx: Column of its center [px].
        cy: Row of its center [px].
        radius: [px].
        edge: Detected edge points (column, row) [px].
    """

    cx: float
    cy: float
    radius: float
    edge: Float[np.ndarray, "n 2"]

    def radius_about(self, cx: float, cy: float) -> float:
        """Median distance of the edge from another center [px]."""
        return float(np.median(np.linalg.norm(self.edge - (cx, cy), axis=1)))


def image_circle(images: Sequence[UInt8[np.ndarray, "h w 3"]]) -> ImageCircle | None:
    """Detect the image circle of images of one camera; None without a dark rim of that shape.

    Each pixel takes a high quantile, over the images, of its brightest channel (exceeded in a tenth
    of them), so that objects that are dark in some do not count. Along each direction from the
    middle, the last position brighter than the dark sensor is found; the edge is where the value
    falls to half of that 4 px further inside. Directions that are bright up to the border are
    ignored. The circle minimizes Huber's function of the distances.
    """
    height, width = images[0].shape[:2]
    bright = np.quantile([image.max(axis=2) for image in images], 0.9, axis=0)
    bright = scipy.ndimage.gaussian_filter(np.asarray(bright, float), 1.0)
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    angle = 2.0 * np.pi * np.arange(_NUM_DIRECTIONS) / _NUM_DIRECTIONS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    with np.errstate(divide="ignore"):
        reach = np.min(middle / np.abs(direction), axis=1)
    steps = np.arange(0.0, reach.max(), _STEP)
    at = middle + steps[:, None, None] * direction
    profile = scipy.ndimage.map_coordinates(
        bright, np.moveaxis(at, -1, 0)[::-1], order=1, cval=np.nan
    )
    median, dark = float(np.nanmedian(profile)), float(np.quantile(bright, _DARK_QUANTILE))
    if dark > _MAX_DARK * median:
        return None
    limit = max(_NOISE, dark + _DARK_FRACTION * (median - dark))
    lit = profile > limit  # NaN beyond the image counts as not lit
    inside = np.maximum(_last(lit) - round(_RIM / _STEP), 0)
    rim = profile[inside, np.arange(_NUM_DIRECTIONS)]
    last = _last(profile > np.maximum(limit, 0.5 * rim))
    seen = lit.any(axis=0) & (steps[last] < reach - 2.0)
    if seen.mean() < _MIN_FRACTION:
        return None
    return _fitted((middle + steps[last][:, None] * direction)[seen], middle)


def _last(true: np.ndarray) -> np.ndarray:
    """Index of the last true value in each column."""
    return len(true) - 1 - np.argmax(true[::-1], axis=0)


def _fitted(edge: np.ndarray, middle: np.ndarray) -> ImageCircle | None:
    """Circle through edge points; None if they do not lie on a circle."""
    radius = float(np.median(np.linalg.norm(edge - middle, axis=1)))

    def distance(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(edge - x[:2], axis=1) - x[2]

    solution = scipy.optimize.least_squares(distance, [*middle, radius], loss="huber", f_scale=0.5)
    cx, cy, radius = map(float, solution.x)
    if np.median(np.abs(distance(solution.x))) > _MAX_SCATTER * radius:
        return None
    return ImageCircle(cx, cy, radius, edge)
