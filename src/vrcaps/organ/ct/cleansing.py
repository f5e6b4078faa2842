"""Electronic cleansing: tagged (contrast-enhanced) fluid in the lumen counts as lumen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from vrcaps.errors import UnknownNameError
from vrcaps.organ.ct.parts import connected_parts
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.organ.ct.lumen import Gas
    from vrcaps.organ.ct.volume import Volume

DOWN = {"supine": (1, 1), "prone": (1, -1), "left-lateral": (2, 1), "right-lateral": (2, -1)}
"""Array axis of a scan, and the sense along it, that gravity had when the patient lay so."""

_TAGGED = 200  # Hounsfield units above which a voxel is tagged fluid, bone or metal
_CONTACT = 4 * MM  # from fluid straight up to gas; bone keeps a wall and fat between
_LEVEL_AREA = 25 * MM * MM  # of a fluid's level, below which it is not taken for one
_SKIRT = 2  # voxels around fluid in which its partial volume with the wall is resolved


@dataclass(frozen=True)
class Fluid:
    """Tagged fluid that lies under gas.

    Attributes:
        label: Number of the pool that each voxel belongs to, 0 where there is none.
        contacts: Pairs of a piece of gas (its number) and the pool under it.
        hounsfield: Median of the fluid's inner voxels.
        down: Array axis of gravity and the sense along it.
    """

    label: Int[np.ndarray, "k j i"]
    contacts: tuple[tuple[int, int], ...]
    hounsfield: float
    down: tuple[int, int]

    def reached(self, start: int) -> tuple[set[int], set[int]]:
        """Pieces of gas and pools that hang together with a piece of gas."""
        pieces, pools = {start}, set()
        while True:
            more_pools = {pool for piece, pool in self.contacts if piece in pieces} - pools
            more = {piece for piece, pool in self.contacts if pool in more_pools} - pieces
            if not more_pools:
                return pieces, pools
            pools |= more_pools
            pieces |= more


def find_fluid(scan: Volume, gas: Gas, *, posture: str) -> Fluid:
    """Tagged fluid: bright, and with a level under the gas of what may be gut.

    Bone is as bright, but gas never lies within 4 mm straight above 25 mm² of it.

    Args:
        scan: Hounsfield units.
        gas: All gas in it.
        posture: How the patient lay, a name of `DOWN`.

    Raises:
        UnknownNameError: If the posture is none of them.
    """
    if posture not in DOWN:
        raise UnknownNameError("posture", posture, DOWN)
    axis, sense = DOWN[posture]
    label, num = connected_parts(scan.values > _TAGGED)
    is_gut = np.zeros(int(gas.label.max()) + 1, bool)
    is_gut[[piece.number for piece in gas.gut]] = True
    columns = {}
    for step in range(1, 1 + max(1, round(_CONTACT / scan.spacing[axis]))):
        # Gas above, fluid `step` voxels below it.
        upper, lower = _shifted_pair(axis, sense * step)
        for above, below in zip(gas.label[upper], label[lower], strict=True):
            both = (above > 0) & (below > 0)
            pairs, counts = np.unique(
                np.stack([above[both], below[both]]), axis=1, return_counts=True
            )
            for piece, pool, count in zip(*pairs.tolist(), counts.tolist(), strict=True):
                if is_gut[piece]:
                    columns[piece, pool] = columns.get((piece, pool), 0) + count
    sides = np.delete(scan.spacing, axis)
    needed = _LEVEL_AREA / float(sides.prod())
    contacts = tuple(pair for pair, count in sorted(columns.items()) if count >= needed)
    keep = np.zeros(num + 1, bool)
    keep[[pool for _, pool in contacts]] = True
    label[~keep[label]] = 0
    inner = scan.values[ndimage.binary_erosion(label > 0)]
    level = float(np.median(inner)) if len(inner) else float(_TAGGED * 2)
    return Fluid(label, contacts, level, (axis, sense))


def cleansed_share(
    share: Float[np.ndarray, "k j i"],
    values: Int[np.ndarray, "k j i"],
    pools: Bool[np.ndarray, "k j i"],
    core: Bool[np.ndarray, "k j i"],
    levels: tuple[float, float],
    down: tuple[int, int],
) -> Float[np.ndarray, "k j i"]:
    """The lumen fraction with pools of fluid in it.

    Around fluid the fraction is linear from the wall's Hounsfield units to the fluid's. The
    layer between fluid and the gas above it passes through the wall's value without being
    wall; there the fraction is interpolated straight from below it to above it.

    Args:
        share: Lumen fraction of the gas.
        values: Hounsfield units of the same voxels.
        pools: Voxels of the fluid.
        core: Voxels of the gas.
        levels: Hounsfield units of the wall and of the fluid.
        down: Array axis of gravity and the sense along it.
    """
    tissue, fluid = levels
    near = ndimage.binary_dilation(pools, iterations=_SKIRT)
    wet = np.clip((values - tissue) / (fluid - tissue), 0.0, 1.0)
    share = np.where(near, np.maximum(share, wet), share).astype(np.float32)
    axis, sense = down
    flow = [np.moveaxis(a, axis, 0)[::sense] for a in (share, pools, core)]
    layer = _level_layer(flow[1], flow[2])
    _bridge_layer(flow[0], layer)
    return share


def _shifted_pair(axis: int, step: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of an array and of the same array `step` further along an axis."""
    first, second = [slice(None)] * 3, [slice(None)] * 3
    first[axis] = slice(None, -step) if step > 0 else slice(-step, None)
    second[axis] = slice(step, None) if step > 0 else slice(None, step)
    return tuple(first), tuple(second)


def _level_layer(
    pools: Bool[np.ndarray, "d a b"], core: Bool[np.ndarray, "d a b"]
) -> Bool[np.ndarray, "d a b"]:
    """Voxels between gas above and fluid below, axis 0 running down; and those beside them."""
    reach = 4
    above = np.zeros_like(core)
    below = np.zeros_like(core)
    for step in range(1, reach + 1):
        above[step:] |= core[:-step]
        below[:-step] |= pools[step:]
    layer = above & below
    # A voxel of gas or fluid on either side also belongs: the level's own blur reaches there.
    layer = ndimage.binary_dilation(layer, np.ones((3, 1, 1), bool))
    beside = ndimage.generate_binary_structure(3, 1)
    beside[[0, 2]] = False
    return ndimage.binary_dilation(layer, beside, iterations=2)


def _bridge_layer(share: Float[np.ndarray, "d a b"], layer: Bool[np.ndarray, "d a b"]) -> None:
    """Fill a layer in place, linearly along axis 0 between what is beyond it."""
    depth = len(share)
    rows = np.arange(depth)[:, None]
    flat, marked = share.reshape(depth, -1), layer.reshape(depth, -1)
    columns = np.flatnonzero(marked.any(axis=0))
    marked, values = marked[:, columns], flat[:, columns]
    last = np.maximum.accumulate(np.where(marked, -1, rows), axis=0)
    following = np.minimum.accumulate(np.where(marked, depth, rows)[::-1], axis=0)[::-1]
    last, following = np.clip(last, 0, None), np.clip(following, None, depth - 1)
    weight = (rows - last) / np.maximum(following - last, 1)
    each = np.arange(len(columns))
    filled = (1.0 - weight) * values[last, each] + weight * values[following, each]
    filled = np.where(marked, filled, values)
    at = np.unravel_index(columns, share.shape[1:])
    share[:, at[0], at[1]] = filled
