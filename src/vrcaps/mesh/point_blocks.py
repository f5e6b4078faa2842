"""Points in blocks of consecutive ones, to find those in a box without a test of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_SIZE = 256
"""Number of points of a block."""


@dataclass(frozen=True)
class PointBlocks:
    """Points with the bounds of their blocks.

    Blocks are small where consecutive points are near each other, as in generated organs.

    Attributes:
        points: Positions [m].
        low: Minimum of each block [m].
        high: Maximum of each block [m].
    """

    points: Float[np.ndarray, "n 3"]
    low: Float[np.ndarray, "b 3"]
    high: Float[np.ndarray, "b 3"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "n 3"]) -> PointBlocks:
        """Blocks of at least one point [m]."""
        starts = np.arange(0, len(points), _SIZE)
        low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
        return cls(points, low, high)

    def near(self, center: Float[np.ndarray, " 3"], reach: float) -> Int[np.ndarray, " k"]:
        """Indices of the points in a cube, in order.

        Args:
            center: Center of the cube [m].
            reach: Half its width [m].
        """
        meets = (self.low - center < reach) & (self.high - center > -reach)
        blocks = np.flatnonzero(meets.all(axis=1))
        indices = (blocks[:, None] * _SIZE + np.arange(_SIZE)).ravel()
        indices = indices[: np.searchsorted(indices, len(self.points))]
        return indices[is_in_box(self.points[indices], center, reach)]


def is_in_box(
    points: Float[np.ndarray, "n 3"], center: Float[np.ndarray, " 3"], reach: float
) -> Bool[np.ndarray, " n"]:
    """Check which points lie in a cube.

    Args:
        points: Positions [m].
        center: Center of the cube [m].
        reach: Half its width [m].
    """
    inside = np.abs(points - center) < reach
    return np.asarray(inside[:, 0] & inside[:, 1] & inside[:, 2])  # faster than `all`
