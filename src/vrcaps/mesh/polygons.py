"""Polygons of mesh files, cut into triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Int


def triangulate_fans(counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Triangles of polygons stored one after the other, as a fan about each first corner.

    Args:
        counts: Number of corners of each polygon; one with fewer than 3 gives no triangle.

    Returns:
        Positions of each triangle's corners in the concatenated corner list.
    """
    counts = np.asarray(counts, np.int64)
    num_triangles = np.maximum(counts - 2, 0)
    starts = np.cumsum(counts) - counts
    first = np.repeat(starts, num_triangles)
    step = np.arange(len(first)) - np.repeat(
        np.cumsum(num_triangles) - num_triangles, num_triangles
    )
    return np.stack([first, first + step + 1, first + step + 2], axis=1)
