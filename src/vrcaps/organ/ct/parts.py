"""Connected parts of a mask."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Bool, Int


def connected_parts(mask: Bool[np.ndarray, "k j i"]) -> tuple[Int[np.ndarray, "k j i"], int]:
    """Number of the part that each voxel belongs to (0 for none), and how many there are.

    Voxels hang together across faces only, so that thin walls part them.
    """
    label = np.empty(mask.shape, np.int32)
    num = ndimage.label(mask, output=label)
    assert isinstance(num, int)
    return label, num
