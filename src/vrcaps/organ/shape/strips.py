"""Texture coordinates of a long tube: strips of its length laid side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

GAP = 4 * MM
"""Between strips, and twice what is left at the borders [m of wall]: 16 texels at 4 per mm, so
that what pads one strip never meets what pads the next."""


def strip_coordinates(
    turn: Float[np.ndarray, "m 3"],
    along: Float[np.ndarray, "m 3"],
    radius: Float[np.ndarray, "m 3"],
    area: float,
) -> Float[np.ndarray, "m 3 2"]:
    """Texture coordinates of each corner of each face, u around the tube and v along it.

    The tube is cut across into n strips of equal length, as many as make their row nearly
    square. Each is as wide as its own mean circumference, so that texels are about as dense
    around the tube as along it, in wide segments as in narrow ones. A face across a cut
    belongs to the strip that holds its middle; none reaches across u = 0 or 1 or v = 0 or 1.

    Args:
        turn: Way around the tube from the seam, 0 to 1, at each corner; a corner on the seam
            takes the value of its face's side.
        along: Length along the tube from 0 [m].
        radius: Distance from the centreline [m].
        area: Of the wall [m²], folds included.
    """
    # Width n C and height A / (n C) are equal at n = √A / C.
    num_strips = max(1, round(np.sqrt(area) / (2.0 * np.pi * radius.mean())))
    middle = along.mean(axis=1) / along.max()
    strip = np.minimum((num_strips * middle).astype(int), num_strips - 1)
    faces_of = [strip == k for k in range(num_strips)]
    width = np.array([2.0 * np.pi * radius[is_in].mean() for is_in in faces_of])
    low = np.array([along[is_in].min() for is_in in faces_of])
    high = np.array([along[is_in].max() for is_in in faces_of])
    left = np.cumsum(width + GAP) - width - 0.5 * GAP
    u = (left[strip, None] + width[strip, None] * turn) / (width + GAP).sum()
    v = (along - low[strip, None] + 0.5 * GAP) / ((high - low).max() + GAP)
    return np.stack([u, v], axis=-1)
