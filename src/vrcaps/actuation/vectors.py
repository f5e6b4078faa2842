"""Vector algebra for single vectors in control loops.

The loops process one vector at a time, hundreds of times per second, for which NumPy's batch
functions take ten times as long. Rotation vectors are in `vrcaps.core.transforms`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


def length(vector: Float[np.ndarray, " 3"]) -> float:
    """Euclidean norm of a vector."""
    return math.sqrt(float(vector @ vector))


def clamp_norm(vector: Float[np.ndarray, " 3"], limit: float) -> Float[np.ndarray, " 3"]:
    """Shorten a vector to a norm of at most `limit`, keeping its direction."""
    size = length(vector)
    return vector if size <= limit else vector * (limit / size)


def detour(
    start: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    center: Float[np.ndarray, " 3"],
    radius: float,
) -> Float[np.ndarray, " 3"]:
    """Next waypoint on the way from `start` to `end` around a sphere.

    It is `end` if the straight line misses the sphere. Otherwise it lies beyond the point at which
    a straight line from `start` touches the sphere, on the side of the line to `end`. An `end`
    inside the sphere is moved to its surface.
    """
    out = end - center
    end = center + out * max(1.0, radius / max(length(out), 1e-12))
    from_center = start - center
    step = end - start
    fraction = -float(from_center @ step) / max(float(step @ step), 1e-12)
    nearest = from_center + min(fraction, 1.0) * step
    if fraction <= 0.0 or length(nearest) >= (1.0 - 1e-9) * radius:
        return end
    distance = max(length(from_center), 1e-12)
    back = from_center / distance
    aside = nearest - (nearest @ back) * back
    if length(aside) < 1e-6 * radius:  # the line passes through the center
        aside = np.cross(back, np.eye(3)[np.argmin(np.abs(back))])
    aside = aside / length(aside)
    cosine = min(1.0, radius / distance)
    sine = math.sqrt(1.0 - cosine * cosine)
    ahead = min(radius, length(step))
    tangent_point = radius * (cosine * back + sine * aside)
    return center + tangent_point + ahead * (cosine * aside - sine * back)
