"""Ends of a lumen: the centers of the two pouches farthest apart inside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.organ.centerline.lumen import LumenGrid

_WALL_COST = 2.0  # of a step next to the wall, in steps through free lumen
_SLENDER = 3.0  # maximum volume of an end pouch, in cubes of its depth
_MIN_DEPTH = 4.0  # minimum depth of an end pouch [voxels]
_CENTRAL = 4.0  # exponent of the wall distance that weights a pouch's voxels


def far_end(
    grid: LumenGrid, seed: Float[np.ndarray, " 3"], outside_cost: float
) -> Float[np.ndarray, " 3"] | None:
    """Center [voxels] of the pouch farthest from a seed; None if over 1 % is unreachable.

    The farthest voxel of a wide pouch depends on small details of its wall; the mean of all voxels
    less than a depth w before it does not. w is the minimum depth at which their volume is at most
    3 w³ (at the end of a tube, its radius), so that a narrow end is its own pouch. Voxels are
    weighted by the fourth power of their distance from the wall.

    Args:
        grid: The lumen.
        seed: Start of the search [voxels].
        outside_cost: Cost of a step outside the lumen, in steps inside; negative forbids it.
    """
    depth = _depth(grid, seed, outside_cost)
    return None if depth is None else _middle(grid, depth)


def any_end(grid: LumenGrid, outside_cost: float) -> Float[np.ndarray, " 3"] | None:
    """Center [voxels] of the pouch farthest from the widest point; see `far_end`.

    In a round lumen the farthest voxels lie all around the widest point. Their center is then
    not an end: it is nearer to the widest point than to them. A single farthest voxel is on one
    side, so the search for the end starts there.
    """
    widest = np.array(np.unravel_index(np.argmax(grid.clearance), grid.inside.shape))
    depth = _depth(grid, widest, outside_cost)
    if depth is None:
        return None
    end = _middle(grid, depth)
    if not 0.5 * depth[tuple(widest)] < depth[nearest_voxel(end)] < np.inf:
        return end
    farthest = np.array(np.unravel_index(np.argmin(depth), depth.shape))
    return far_end(grid, farthest, outside_cost)


def _middle(grid: LumenGrid, depth: Float[np.ndarray, "x y z"]) -> Float[np.ndarray, " 3"]:
    """Center [voxels] of the farthest pouch; its most central voxel if that is near a wall."""
    pouch = _pouch(depth, _pouch_depth(depth))
    weight = grid.clearance[tuple(pouch.T)] ** _CENTRAL
    middle = weight @ pouch / weight.sum()
    deepest = pouch[np.argmax(weight)]
    is_central = grid.clearance[nearest_voxel(middle)] > 0.5 * grid.clearance[tuple(deepest)]
    return middle if is_central else deepest.astype(float)


def _depth(
    grid: LumenGrid, seed: Float[np.ndarray, " 3"], outside_cost: float
) -> Float[np.ndarray, "x y z"] | None:
    """Distance from the seed relative to the farthest voxel, in steps; see `far_end`.

    Infinite outside the lumen and next to its wall; None if over 1 % is unreachable.
    """
    from skimage.graph import MCP_Geometric

    free = grid.clearance >= grid.voxel
    cost = np.where(grid.inside, np.where(free, 1.0, _WALL_COST), outside_cost)
    # Steps across faces only: a diagonal step may slip through a thin wall.
    walked, _ = MCP_Geometric(cost, fully_connected=False).find_costs([nearest_voxel(seed)])
    reached = np.isfinite(walked) & grid.inside
    if np.count_nonzero(reached) < 0.99 * np.count_nonzero(grid.inside):
        return None
    free &= reached
    counted = free if free.any() else reached
    return np.where(counted, walked[counted].max() - walked, np.inf)


def nearest_voxel(place: Float[np.ndarray, " 3"]) -> tuple[int, int, int]:
    """Index of the voxel at a position [voxels]."""
    x, y, z = np.rint(place).astype(int).tolist()
    return x, y, z


def _pouch_depth(depth: Float[np.ndarray, "x y z"]) -> float:
    """Minimum depth [voxels] whose volume is at most `_SLENDER` cubes of it."""
    depth = np.sort(depth[np.isfinite(depth)])
    slender = np.arange(1, len(depth) + 1) <= _SLENDER * depth**3
    slender &= depth >= _MIN_DEPTH
    return float(depth[np.argmax(slender)]) if slender.any() else float(depth[-1])


def _pouch(depth: Float[np.ndarray, "x y z"], limit: float) -> Int[np.ndarray, "n 3"]:
    """Voxels up to a depth that are connected to the farthest, within twice this depth."""
    wide = np.empty(depth.shape, np.int32)
    scipy.ndimage.label(depth <= 2.0 * limit, output=wide)
    farthest = np.unravel_index(np.argmin(depth), depth.shape)
    return np.argwhere((wide == wide[farthest]) & (depth <= limit))
