"""Handles of a lumen: openings between touching loops, and their removal."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.mesh.edges import find_edges
from vrcaps.organ.centerline.lumen import LumenGrid, num_pieces

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_APART = 5  # minimum distance between the centers of two chambers [voxels]
_DETOUR = 2.5  # path along the lumen, in chamber diameters, beyond which a contact is a short cut
_OFFSETS = [
    (i, j, k) for i in (0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)
]
"""Half of a voxel's 26 neighbors; symmetry covers the other half."""


def num_handles(faces: Int[np.ndarray, "m 3"]) -> int:
    """Number of handles of a closed surface, by Euler: V − E + F = 2 pieces − 2 handles."""
    euler = len(np.unique(faces)) - len(find_edges(faces).counts) + len(faces)
    return max(0, (2 * num_pieces(faces) - euler) // 2)


def without_short_cuts(grid: LumenGrid) -> tuple[LumenGrid, int]:
    """Close the short cuts between loops of a lumen, and count them.

    The lumen is divided into chambers around its widest points (a watershed of the distance from
    the wall). Their contacts form a graph; its maximum spanning tree by contact width is the
    course of the lumen, since it omits the narrowest contact of each cycle (Cormen et al.,
    Introduction to Algorithms, ch. 23). An omitted contact is closed if the path along the tree
    is long; a short one only goes around a fold.
    """
    from skimage.segmentation import watershed

    highest = scipy.ndimage.maximum_filter(grid.clearance, 2 * _APART + 1)
    peaks = np.empty(grid.inside.shape, np.int32)
    scipy.ndimage.label(grid.inside & (grid.clearance == highest), np.ones((3, 3, 3)), output=peaks)
    num = int(peaks.max())
    if num < 3:
        return grid, 0
    chamber = watershed(-grid.clearance, peaks, mask=grid.inside)
    voxels, key, width = _contacts(chamber, grid.clearance, num)
    pairs, first = np.unique(key, return_inverse=True)
    widest = np.zeros(len(pairs))
    np.maximum.at(widest, first, width)
    a, b = np.divmod(pairs, num + 1)
    middle = np.array(scipy.ndimage.center_of_mass(peaks > 0, peaks, np.arange(num + 1)[1:]))
    middle = np.vstack([np.full(3, np.nan), middle])
    shape = (num + 1, num + 1)
    tree = scipy.sparse.csgraph.minimum_spanning_tree(
        scipy.sparse.coo_array((1.0 / widest, (a, b)), shape=shape).tocsr()
    ).tocoo()
    step = np.linalg.norm(middle[tree.row] - middle[tree.col], axis=1) * grid.voxel
    way = scipy.sparse.csgraph.shortest_path(
        scipy.sparse.coo_array((step, (tree.row, tree.col)), shape=shape), directed=False
    )
    size = np.concatenate(
        [[0.0], scipy.ndimage.maximum(grid.clearance, peaks, np.arange(1, num + 1))]
    )
    is_cut = way[a, b] > 2.0 * _DETOUR * (size[a] + size[b])
    if not is_cut.any():
        return grid, 0
    closed = voxels[is_cut[first]]
    inside, clearance = grid.inside.copy(), grid.clearance.copy()
    inside.ravel()[closed], clearance.ravel()[closed] = False, 0.0
    return replace(grid, inside=inside, clearance=clearance), int(is_cut.sum())


def _contacts(
    chamber: Int[np.ndarray, "x y z"], clearance: Float[np.ndarray, "x y z"], num: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Voxels next to another chamber, of the lower index; key of the pair; and clearance there.

    The key of chambers a < b is a (num + 1) + b. The clearance is the minimum of both voxels.
    """
    label, clear = chamber.ravel(), clearance.ravel()
    ids = np.flatnonzero(label)
    _, ny, nz = chamber.shape
    found = []
    for i, j, k in _OFFSETS:
        beside = ids + (i * ny + j) * nz + k  # the grid's margin is outside
        other = label[beside]
        at = np.flatnonzero((other > 0) & (other != label[ids]))
        one, two = ids[at], beside[at]
        is_first = label[one] < label[two]
        low, high = np.where(is_first, one, two), np.where(is_first, two, one)
        key = label[low].astype(np.int64) * (num + 1) + label[high]
        found.append((low, key, np.minimum(clear[low], clear[high]).astype(float)))
    voxels, key, width = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return voxels, key, width
