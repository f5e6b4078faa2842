"""What an endoscope's picture shows beside tissue: black corners, inserts, text.

They differ between hospitals and classes, so a network can tell classes by them and learn nothing
of tissue. They are hidden in every image at the same place, whether they are there or not: a mask
that followed the image would tell what it hides.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool

Overlay = Literal["corners", "insert", "text"]

_RADIUS = 0.46
"""Half axes of the ellipse that is left of an image, over its sides: it lies within the octagons
and circles of HyperKvasir, Kvasir-SEG and WCEBleedGen."""
_INSERT = (0.56, 0.45)
"""Top and right edge of the lower left part where HyperKvasir shows the place of the endoscope."""
_TEXT = 0.27
"""Right edge of the left part where HyperKvasir and Kvasir-SEG show date and name."""


@lru_cache(maxsize=64)
def tissue_mask(height: int, width: int, overlays: tuple[Overlay, ...]) -> Bool[np.ndarray, "h w"]:
    """Where tissue is seen in every image whose overlays of these kinds are hidden.

    Args:
        height: Of the image [px].
        width: Of the image [px].
        overlays: `corners` leaves the largest ellipse that capsules and endoscopes show, `insert`
            hides the lower left, `text` the left.
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
