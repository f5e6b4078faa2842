"""Class of an image: normal wall, or the lesion with the largest area."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.lumen.particles import FIRST_CLUMP

if TYPE_CHECKING:
    from jaxtyping import UInt16

NORMAL = "normal"
"""Class of images without a lesion."""


def image_class(
    instance: UInt16[np.ndarray, "h w"], lesions: Sequence[dict[str, Any]], min_fraction: float
) -> str | None:
    """Kind of the largest lesion in an image, or `NORMAL`; None if the largest is too small.

    Args:
        instance: Lesion ID of each pixel.
        lesions: Lesions of the organ, as in `organ.lesions` of an episode.
        min_fraction: Fraction of the image that the lesion must cover.
    """
    pixels = np.bincount(lesion_instances(instance).ravel())[1:]
    if not pixels.any():
        return NORMAL
    if pixels.max() < min_fraction * instance.size:
        return None
    kinds = {one["instance"]: one["kind"] for one in lesions}
    return kinds.get(int(pixels.argmax()) + 1)


def lesion_instances(instance: UInt16[np.ndarray, "h w"]) -> UInt16[np.ndarray, "h w"]:
    """Lesion ID of each pixel of a recording; 0 also where it shows a clump of chyme."""
    return np.where(instance < FIRST_CLUMP, instance, np.uint16(0))
