"""What an image is a picture of: normal wall, or the lesion that takes most of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.lumen.particles import FIRST_CLUMP

if TYPE_CHECKING:
    from jaxtyping import UInt16

NORMAL = "normal"
"""Class of images without a lesion."""


def shown_lesion(
    instance: UInt16[np.ndarray, "h w"], lesions: Sequence[dict[str, Any]], min_fraction: float
) -> str | None:
    """Kind of the lesion that takes most of an image, or `NORMAL`; None where it takes too little.

    Args:
        instance: Lesion number of each pixel.
        lesions: Those of the organ, as `organ.lesions` of an episode has them.
        min_fraction: Share of the image that the lesion must take.
    """
    pixels = np.bincount(lesion_instances(instance).ravel())[1:]
    if not pixels.any():
        return NORMAL
    if pixels.max() < min_fraction * instance.size:
        return None
    kinds = {one["instance"]: one["kind"] for one in lesions}
    return kinds.get(int(pixels.argmax()) + 1)


def lesion_instances(instance: UInt16[np.ndarray, "h w"]) -> UInt16[np.ndarray, "h w"]:
    """Lesion number of each pixel of a recording; 0 where it shows a clump of chyme, too."""
    return np.where(instance < FIRST_CLUMP, instance, np.uint16(0))
