"""Planar images with a margin: one plane per color, the input layout of the camera pipeline."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


def crop_margin(
    planes: Float[np.ndarray, "3 h+2m w+2m"], height: int, width: int
) -> Float[np.ndarray, "3 h w"]:
    """Return the image without the margin, as a view."""
    margin = (planes.shape[1] - height) // 2
    return planes[:, margin : margin + height, margin : margin + width]
