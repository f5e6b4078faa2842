"""Extent of a measurement."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Extent:
    """Extent of a measurement.

    Attributes:
        num_triangles: Approximate number of triangles of the wall.
        coarsest: Approximate number of triangles of the smallest wall in their comparison.
        num_subdivisions: Number of subdivisions of that wall, by four each.
        sizes: Side lengths of square images [px], ascending.
        num_views: Number of views along the organ.
        num_rounds: Number of rounds.
    """

    num_triangles: int = 100_000
    coarsest: int = 25_000
    num_subdivisions: int = 3
    sizes: tuple[int, ...] = (160, 320, 640, 1280)
    num_views: int = 8
    num_rounds: int = 21


FULL = Extent()
QUICK = Extent(num_triangles=30_000, coarsest=20_000, num_subdivisions=1, num_views=2, num_rounds=3)
"""Quick check; the values are meaningless."""
