"""Turns of one body at a time, in plain numbers or in the core.

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


def at_most(vector: Float[np.ndarray, " 3"], most: float) -> Float[np.ndarray, " 3"]:
    """A vector, cut to a length."""
    size = length(vector)
    return vector if size <= most else vector * (most / size)
