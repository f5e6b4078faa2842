"""Endoscopic images at one scale: the disc shown by an image, and its valid pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

SIZE = 160
"""Diameter of the disc in pixels, of every image compared."""

_DARK = 24
_DISC_SHARE = 0.90


def read_disc(path: Path) -> np.ndarray:
    """The disc of an image file, as `disc` gives it."""
    return disc(np.asarray(Image.open(path).convert("RGB")))


def disc(rgb: np.ndarray) -> np.ndarray:
    """The middle of the field of view, `SIZE` pixels wide.

    The view is the bounding box of rows and columns in which a fifth is brighter than 24 of 255
    in a channel: this leaves out black borders and words printed on them. Of it, a square of
    0.9 of its shorter side about its middle is taken and its pixels averaged.
    """
    bright = rgb.max(axis=2) > _DARK
    rows = np.flatnonzero(bright.mean(axis=1) > 0.2)
    columns = np.flatnonzero(bright.mean(axis=0) > 0.2)
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    half = 0.5 * _DISC_SHARE * min(bottom - top, right - left)
    x, y = 0.5 * (left + right), 0.5 * (top + bottom)
    picture = Image.fromarray(rgb)
    box = (x - half, y - half, x + half, y + half)
    return np.asarray(picture.resize((SIZE, SIZE), Image.Resampling.BOX, box=box))


def valid_pixels(overlays: bool) -> np.ndarray:
    """Mask of the disc; with `overlays`, without the areas in which HyperKvasir's recorders print.

    Those are its left sixth, and its left two fifths in the lowest third. One mask serves all
    images of a comparison, whether they have text or not.
    """
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    inside = np.hypot(x - 0.5, y - 0.5) < 0.5
    if overlays:
        inside &= (x > 0.17) & ~((x < 0.40) & (y > 0.62))
    return inside
