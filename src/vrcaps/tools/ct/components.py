"""Connected components of a mask, dilation and erosion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Bool, Int, UInt16


def connected_parts(mask: Bool[np.ndarray, "k j i"]) -> tuple[Int[np.ndarray, "k j i"], int]:
    """Label the connected parts: ID of each voxel (0 for none), and the number of parts.

    Voxels are connected across faces only, so that thin walls separate parts.
    """
    label = np.empty(mask.shape, np.int32)
    num = ndimage.label(mask, output=label)
    assert isinstance(num, int)
    return label, num


def part_sizes(label: Int[np.ndarray, "k j i"], num: int) -> Int[np.ndarray, " n"]:
    """Number of voxels of each part; index 0 is the background."""
    sizes = np.zeros(num + 1, np.int64)
    for plane in label:
        sizes += np.bincount(plane.ravel(), minlength=num + 1)
    return sizes


def renumbered(
    label: Int[np.ndarray, "k j i"], number: Int[np.ndarray, " n"]
) -> UInt16[np.ndarray, "k j i"]:
    """Replace the ID of each voxel's part.

    Args:
        label: ID of the part of each voxel.
        number: New ID of each part, below 65,536.
    """
    assert number.max(initial=0) < 2**16
    return number.astype(np.uint16)[label]


def grown(mask: Bool[np.ndarray, "k j i"], num_voxels: int = 1) -> Bool[np.ndarray, "k j i"]:
    """Dilate a mask, each step across one face."""
    for _ in range(num_voxels):
        wider = mask.copy()
        for axis in range(3):
            here, there = np.moveaxis(wider, axis, 0), np.moveaxis(mask, axis, 0)
            here[1:] |= there[:-1]
            here[:-1] |= there[1:]
        mask = wider
    return mask


def shrunk(mask: Bool[np.ndarray, "k j i"], num_voxels: int = 1) -> Bool[np.ndarray, "k j i"]:
    """Erode a mask; it is not eroded at the border of the array."""
    return ~grown(~mask, num_voxels)
