"""Turns of one body at a time, in plain numbers.

They run hundreds of times a second, where NumPy's functions for batches take ten times as long.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

_NEAR_HALF = -0.99
"""Cosine beyond which a turn is so near to half a turn that its sine says no axis."""


def cross(a: Float[np.ndarray, " 3"], b: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Cross product of two vectors."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def length(vector: Float[np.ndarray, " 3"]) -> float:
    """Length of a vector."""
    return math.sqrt(float(vector @ vector))


def turned(
    vector: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3 3"]:
    """A rotation, turned further by a rotation vector [rad] in the same frame.

    Rodrigues' formula; the result is kept orthonormal by a step of Newton's iteration.
    """
    angle = length(vector)
    if angle == 0.0:
        return rotation.copy()
    x, y, z = (vector / angle).tolist()
    s, c = math.sin(angle), math.cos(angle)
    k = 1.0 - c
    turn = np.array(
        [
            [c + k * x * x, k * x * y - s * z, k * x * z + s * y],
            [k * x * y + s * z, c + k * y * y, k * y * z - s * x],
            [k * x * z - s * y, k * y * z + s * x, c + k * z * z],
        ]
    )
    product = turn @ rotation
    return 1.5 * product - 0.5 * product @ product.T @ product


def rotation_vector(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 3"]:
    """Axis times angle [rad] of a rotation, 0 to π."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    across = np.array([h - f, c - g, d - b])
    sine, cosine = 0.5 * length(across), 0.5 * (a + e + i - 1.0)
    if cosine < _NEAR_HALF:
        # R + Rᵀ = 2 c 1 + 2 (1 − c) a aᵀ: the longest column has the axis.
        square = rotation + rotation.T - 2.0 * cosine * np.eye(3)
        axis = square[:, int(np.argmax(np.diag(square)))]
        axis = axis / length(axis)
        axis = -axis if axis @ across < 0.0 else axis
        return axis * math.atan2(sine, cosine)
    return across * (0.5 * math.atan2(sine, cosine) / sine if sine > 0.0 else 0.5)


def towards(
    start: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    most: float,
    about: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, " 3"]:
    """A direction turned towards another by `most` [rad]; about an axis where they are opposite."""
    axis = cross(start, end)
    sine = length(axis)
    if math.atan2(sine, float(start @ end)) <= most:
        return end
    unit = axis / sine if sine > 1e-9 else about
    led = turned(most * unit, np.eye(3)) @ start
    return led / length(led)


def at_most(vector: Float[np.ndarray, " 3"], most: float) -> Float[np.ndarray, " 3"]:
    """A vector, cut to a length."""
    size = length(vector)
    return vector if size <= most else vector * (most / size)
