"""Connected parts of a mask, and masks made larger or smaller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Bool, Int, UInt16


def connected_parts(mask: Bool[np.ndarray, "k j i"]) -> tuple[Int[np.ndarray, "k j i"], int]:
    """Number of the part that each voxel belongs to (0 for none), and how many there are.

    Voxels hang together across faces only, so that thin walls part them.
    """
    label = np.empty(mask.shape, np.int32)
    num = ndimage.label(mask, output=label)
    assert isinstance(num, int)
    return label, num


def part_sizes(label: Int[np.ndarray, "k j i"], num: int) -> Int[np.ndarray, " n"]:
    """Number of voxels of each part; of none at 0."""
    sizes = np.zeros(num + 1, np.int64)
    for plane in label:
        sizes += np.bincount(plane.ravel(), minlength=num + 1)
    return sizes


def renumbered(
    label: Int[np.ndarray, "k j i"], number: Int[np.ndarray, " n"]
) -> UInt16[np.ndarray, "k j i"]:
    """New number of each voxel's part.

    Args:
        label: Number of the part that each voxel belongs to.
        number: New number of each part, below 65,536.
    """
    assert number.max(initial=0) < 2**16
    return number.astype(np.uint16)[label]


def grown(mask: Bool[np.ndarray, "k j i"], num_voxels: int = 1) -> Bool[np.ndarray, "k j i"]:
    """A mask and the voxels around it, each step across one face."""
    for _ in range(num_voxels):
        wider = mask.copy()
        for axis in range(3):
            here, there = np.moveaxis(wider, axis, 0), np.moveaxis(mask, axis, 0)
            here[1:] |= there[:-1]
            here[:-1] |= there[1:]
        mask = wider
    return mask


def shrunk(mask: Bool[np.ndarray, "k j i"], num_voxels: int = 1) -> Bool[np.ndarray, "k j i"]:
    """A mask without its outermost voxels; at the array's own border it stays."""
    return ~grown(~mask, num_voxels)
