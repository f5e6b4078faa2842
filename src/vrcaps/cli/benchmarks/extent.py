"""How much is measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Extent:
    """How much is measured.

    Attributes:
        num_triangles: Of the wall, about.
        coarsest: Triangles of the smallest wall in the comparison of triangles, about.
        num_subdivisions: How often that wall is cut into four times as many triangles.
        sizes: Side lengths of square images [px], rising.
        num_views: Views along the organ.
        num_rounds: Rounds of turns.
    """

    num_triangles: int = 100_000
    coarsest: int = 25_000
    num_subdivisions: int = 3
    sizes: tuple[int, ...] = (160, 320, 640, 1280)
    num_views: int = 8
    num_rounds: int = 21


FULL = Extent()
QUICK = Extent(num_triangles=30_000, coarsest=20_000, num_subdivisions=1, num_views=2, num_rounds=3)
"""For a first look: the figures mean nothing."""
