"""Specular highlights of endoscopic images: found by Otsu's threshold, inpainted by Telea's method.

What is thresholded is by how much the least color channel exceeds its median around, brightened as
the greatest channel is: a highlight adds white light, and mucosa is poor in blue. Brightness itself
would not do: near walls are the brightest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tools.reconstruction.opencv import opencv

if TYPE_CHECKING:
    from jaxtyping import Bool, UInt8

_WINDOW = 0.1
"""Side of the median's window, of the image's shorter side."""
_LEAST = 24
"""Excess below which nothing is a highlight [of 255]; Otsu's threshold always parts, even noise."""
_GLOW = 1 / 140
"""Width of the glow around a highlight, of the image's shorter side."""
_REACH_PX = 5
"""From how far around colors are drawn in when inpainting."""


def highlights(rgb: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Where highlights are, with their glow (Otsu, IEEE Trans. SMC 9(1), 1979).

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    side = min(rgb.shape[:2])
    window = min(255, 2 * max(1, round(_WINDOW * side / 2)) + 1)
    least, most = (np.ascontiguousarray(part(rgb, axis=2)) for part in (np.min, np.max))
    around = [cv2.medianBlur(channel, window).astype(np.float32) for channel in (least, most)]
    brighter = np.maximum(most / np.maximum(around[1], 1.0), 1.0)
    excess = np.clip(least - around[0] * brighter, 0.0, 255.0).astype(np.uint8)
    threshold, _ = cv2.threshold(excess, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    found = (excess > max(threshold, _LEAST)).astype(np.uint8)
    glow = 2 * max(1, round(_GLOW * side)) + 1
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (glow, glow))
    return cv2.dilate(found, disk) > 0


def without_highlights(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The image with its highlights inpainted (Telea, J. Graphics Tools 9(1), 2004).

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    mask = highlights(rgb).astype(np.uint8)
    return cv2.inpaint(np.ascontiguousarray(rgb), mask, _REACH_PX, cv2.INPAINT_TELEA)
