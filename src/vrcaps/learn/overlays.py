"""Overlays of an endoscope's picture: black corners, inserts, text.

They differ between hospitals and classes, so that a network can classify by them without using the
tissue. They are hidden in every image at the same position, whether they are present or not: a mask
that followed the image would reveal them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool

Overlay = Literal["corners", "insert", "text"]

_RADIUS = 0.46
"""Half axes of the visible ellipse of an image, relative to its sides: it lies within the octagons
and circles of HyperKvasir, Kvasir-SEG and WCEBleedGen."""
_INSERT = (0.56, 0.45)
"""Top and right edge of the lower left part where HyperKvasir shows the endoscope's position."""
_TEXT = 0.27
"""Right edge of the left part where HyperKvasir and Kvasir-SEG show date and name."""


@lru_cache(maxsize=64)
def tissue_mask(height: int, width: int, overlays: tuple[Overlay, ...]) -> Bool[np.ndarray, "h w"]:
    """Mask of the pixels that are not hidden by the overlays.

    Args:
        height: Height of the image [px].
        width: Width of the image [px].
        overlays: `corners` keeps the largest ellipse that both capsules and endoscopes show,
            `insert` hides the lower left, `text` the left.
    """
    y = ((np.arange(height) + 0.5) / height)[:, None]
    x = (np.arange(width) + 0.5) / width
    mask = np.ones((height, width), bool)
    if "corners" in overlays:
        mask &= (x - 0.5) ** 2 + (y - 0.5) ** 2 <= _RADIUS**2
    if "insert" in overlays:
        mask &= (y < _INSERT[0]) | (x > _INSERT[1])
    if "text" in overlays:
        mask &= x > _TEXT
    mask.setflags(write=False)
    return mask
