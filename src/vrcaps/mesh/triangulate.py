"""Triangulation of polygons, fans and strips stored as lists of corners."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Int


def triangulate_fans(counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Triangles of concatenated polygons, as a fan about each first corner.

    Args:
        counts: Number of corners of each polygon; one with fewer than 3 gives no triangle.

    Returns:
        Positions of each triangle's corners in the concatenated corner list.
    """
    first, step = _steps(counts)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def triangulate_strips(counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Triangles of concatenated strips; every second one is flipped for consistent orientation.

    Args:
        counts: Number of corners of each strip; one with fewer than 3 gives no triangle.

    Returns:
        Positions of each triangle's corners in the concatenated corner list.
    """
    first, step = _steps(counts)
    start, odd = first + step, step % 2
    return np.stack([start, start + 1 + odd, start + 2 - odd], axis=1)


def _steps(counts: Int[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """First corner of each triangle's list, and the triangle's index in it."""
    counts = np.asarray(counts, np.int64)
    num_triangles = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, num_triangles)
    before = np.repeat(np.cumsum(num_triangles) - num_triangles, num_triangles)
    return first, np.arange(len(first)) - before
