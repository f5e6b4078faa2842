"""Specular highlights of endoscopic images: detected by Otsu's threshold, inpainted by Telea.

The threshold applies to the excess of the least color channel over its local median, scaled like
the greatest channel: a highlight adds white light, and mucosa is poor in blue. Brightness itself
is unsuitable, as near walls are the brightest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.tools.reconstruction.opencv import opencv

if TYPE_CHECKING:
    from jaxtyping import Bool, UInt8

_WINDOW = 0.1
"""Side of the median's window, relative to the image's shorter side."""
_LEAST = 24
"""Minimum excess of a highlight [of 255]; Otsu's threshold always separates, even noise."""
_GLOW = 1 / 140
"""Width of the glow around a highlight, relative to the image's shorter side."""
_REACH_PX = 5
"""Radius of the inpainting [px]."""


def highlights(rgb: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Detect highlights with their glow (Otsu, IEEE Trans. SMC 9(1), 1979).

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
    """Inpaint the highlights of an image (Telea, J. Graphics Tools 9(1), 2004).

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    mask = highlights(rgb).astype(np.uint8)
    return cv2.inpaint(np.ascontiguousarray(rgb), mask, _REACH_PX, cv2.INPAINT_TELEA)
