"""Turns and ways of one body at a time, in plain numbers or in the core.

They run hundreds of times a second, where NumPy's functions for batches take ten times as long.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core

if TYPE_CHECKING:
    from jaxtyping import Float


def length(vector: Float[np.ndarray, " 3"]) -> float:
    """Length of a vector."""
    return math.sqrt(float(vector @ vector))


def turned(
    vector: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3 3"]:
    """A rotation, turned further by a rotation vector [rad] in the same frame; orthonormal."""
    return _core.turned(vector, rotation)


def rotation_vector(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 3"]:
    """Axis times angle [rad] of a rotation, 0 to π."""
    return _core.rotation_vector(rotation)


def past(
    start: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    center: Float[np.ndarray, " 3"],
    radius: float,
) -> Float[np.ndarray, " 3"]:
    """Where to go next from a start to an end past a ball: the end, where nothing is in the way.

    Otherwise beyond the place where a straight way just touches the ball, on the side on which the
    way to the end is. An end in the ball is moved out to its surface.
    """
    out = end - center
    end = center + out * max(1.0, radius / max(length(out), 1e-12))
    from_center, way = start - center, end - start
    share = -float(from_center @ way) / max(float(way @ way), 1e-12)
    nearest = from_center + min(share, 1.0) * way
    if share <= 0.0 or length(nearest) >= (1.0 - 1e-9) * radius:
        return end
    distance = max(length(from_center), 1e-12)
    back = from_center / distance
    aside = nearest - (nearest @ back) * back
    if length(aside) < 1e-6 * radius:  # the way goes right through the centre
        aside = np.cross(back, np.eye(3)[np.argmin(np.abs(back))])
    aside = aside / length(aside)
    cosine = min(1.0, radius / distance)
    sine, ahead = math.sqrt(1.0 - cosine * cosine), min(radius, length(way))
    touch = radius * (cosine * back + sine * aside)
    return center + touch + ahead * (cosine * aside - sine * back)


def at_most(vector: Float[np.ndarray, " 3"], most: float) -> Float[np.ndarray, " 3"]:
    """A vector, cut to a length."""
    size = length(vector)
    return vector if size <= most else vector * (most / size)
