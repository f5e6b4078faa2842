"""Subpixel corner refinement: saddle point of the brightness around each corner."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float

_REACH = 0.35
"""Radius of the window around a corner, as a fraction of the distance to the nearest neighbor."""
_LEAST, _MOST = 2.0, 15.0
"""Min and max radius of the window [px]: small ones see pixels, large ones the lens's curves."""
_SAMPLES = 13
"""Samples across a window."""
_BLUR = 0.7
"""Standard deviation of the blur beforehand [px]; that of a square pixel is 0.29."""
_ROUNDS = 6
_FLAT = 1.0
"""Minimum curvature of a saddle: a gray level over the window's radius, squared."""


def refine_corners(
    gray: Float[np.ndarray, "h w"], grid: Float[np.ndarray, "r c 2"]
) -> Float[np.ndarray, "r c 2"]:
    """Move each corner to the saddle point of a quadratic fitted to the brightness around it.

    Where four squares meet, ``z = a x² + b xy + c y² + d x + e y + f`` fits the blurred
    brightness, and the corner is where its gradient is zero (Lucchese and Mitra, APCCAS 2002).
    Samples weigh less towards the window's rim. A corner is not moved if there is no saddle, or if
    it is farther away than the window's radius.

    Args:
        gray: Brightness of the photograph.
        grid: Corners (column, row) [px], arranged as on the board.
    """
    smooth = scipy.ndimage.gaussian_filter(gray.astype(float), _BLUR)
    radius = np.clip(_REACH * nearest_neighbors(grid), _LEAST, _MOST).reshape(-1)
    step = np.linspace(-1.0, 1.0, _SAMPLES)
    x, y = (part.ravel() for part in np.meshgrid(step, step))
    weight = np.exp(-2.0 * (x**2 + y**2)) * (np.hypot(x, y) <= 1.0)
    terms = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)
    solver = np.linalg.pinv(terms * weight[:, None]) * weight
    start = grid.reshape(-1, 2)
    found, stays = start.copy(), np.zeros(len(start), bool)
    for _ in range(_ROUNDS):
        at = found[:, None] + radius[:, None, None] * np.stack([x, y], axis=-1)
        values = scipy.ndimage.map_coordinates(smooth, np.moveaxis(at, -1, 0)[::-1], mode="nearest")
        a, b, c, d, e, _ = (values @ solver.T).T
        bend = 4.0 * a * c - b * b  # determinant of the Hessian, negative at a saddle
        stays |= bend > -_FLAT
        bend = np.minimum(bend, -_FLAT)
        move = np.stack([b * e - 2.0 * c * d, b * d - 2.0 * a * e], axis=-1) / bend[:, None]
        found = found + np.clip(move, -0.5, 0.5) * radius[:, None]
        stays |= np.linalg.norm(found - start, axis=1) > radius
        found = np.where(stays[:, None], start, found)
    return found.reshape(grid.shape)


def nearest_neighbors(grid: Float[np.ndarray, "r c 2"]) -> Float[np.ndarray, "r c"]:
    """Distance of each corner to the nearest of its neighbors along rows and columns [px]."""
    nearest = np.full(grid.shape[:2], np.inf)
    for axis in (0, 1):
        apart = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        before = [(0, 0), (0, 0)]
        after = [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        for pad in (before, after):
            nearest = np.minimum(nearest, np.pad(apart, pad, constant_values=np.inf))
    return nearest
