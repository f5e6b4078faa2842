"""Electronic cleansing: tagged (contrast-enhanced) fluid in the lumen counts as lumen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import UnknownNameError
from vrcaps.core.units import MM
from vrcaps.tools.ct.lumen import connected_parts, grown, renumbered, shrunk

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt16

    from vrcaps.tools.ct.lumen import Gas
    from vrcaps.tools.ct.volume import Volume

DOWN = {"supine": (1, 1), "prone": (1, -1), "left-lateral": (2, 1), "right-lateral": (2, -1)}
"""Array axis and direction of gravity in a scan, by posture of the patient."""

_TAGGED = 200  # Hounsfield units above which a voxel is tagged fluid, bone or metal
_CONTACT = 4 * MM  # max distance from fluid up to gas; bone has a wall and fat in between
_MIN_AREA = 25 * MM * MM  # minimum area of an air-fluid interface; smaller ones are ignored
_SKIRT = 2  # voxels around fluid in which its partial volume with the wall is resolved


@dataclass(frozen=True)
class AirFluidInterface:
    """Interface between a pool of fluid and the gas above it.

    Attributes:
        piece: ID of the piece of gas.
        pool: ID of the pool of fluid.
        points: Array indices (k, j, i) half-way between the lowest voxel of gas and the
            highest of fluid, one for each column.
    """

    piece: int
    pool: int
    points: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Fluid:
    """Tagged fluid below gas.

    Attributes:
        label: ID of the pool of each voxel, 0 for none.
        interfaces: Interfaces between pools and gas.
        hounsfield: Median of the fluid's inner voxels.
        axis: Array axis of gravity.
    """

    label: UInt16[np.ndarray, "k j i"]
    interfaces: tuple[AirFluidInterface, ...]
    hounsfield: float
    axis: int

    def reached(self, start: int) -> tuple[set[int], set[int]]:
        """IDs of the pieces of gas and of the pools that are connected to a piece of gas."""
        pieces, pools = {start}, set()
        while True:
            more_pools = {
                interface.pool for interface in self.interfaces if interface.piece in pieces
            } - pools
            if not more_pools:
                return pieces, pools
            pools |= more_pools
            pieces |= {
                interface.piece for interface in self.interfaces if interface.pool in more_pools
            }


def find_fluid(scan: Volume, gas: Gas, *, posture: str) -> Fluid:
    """Segment tagged fluid: bright voxels with an air-fluid interface to gas that may be gut.

    Bone is as bright, but gas never lies within 4 mm directly above 25 mm² of it.

    Args:
        scan: Hounsfield units.
        gas: All gas in it.
        posture: Posture of the patient, a name of `DOWN`.

    Raises:
        UnknownNameError: If the posture is unknown.
    """
    if posture not in DOWN:
        raise UnknownNameError("posture", posture, DOWN)
    axis, sense = DOWN[posture]
    label, num = connected_parts(scan.values > _TAGGED)
    reach = max(1, round(_CONTACT / scan.spacing[axis]))
    needed = _MIN_AREA / float(np.delete(scan.spacing, axis).prod())
    interfaces = [
        one
        for one in _find_interfaces(gas, label, (axis, sense), reach)
        if len(one.points) >= needed
    ]
    old = sorted({interface.pool for interface in interfaces})
    new_label = np.zeros(num + 1, int)
    new_label[old] = np.arange(1, len(old) + 1)
    kept = renumbered(label, new_label)
    del label
    inner = scan.values[shrunk(kept > 0)]
    hounsfield = float(np.median(inner)) if len(inner) else float(_TAGGED * 2)
    interfaces = [
        AirFluidInterface(one.piece, int(new_label[one.pool]), one.points) for one in interfaces
    ]
    return Fluid(kept, tuple(interfaces), hounsfield, axis)


def _find_interfaces(
    gas: Gas, pools: Int[np.ndarray, "k j i"], down: tuple[int, int], reach: int
) -> list[AirFluidInterface]:
    """Find where gas that may be gut ends downwards and something bright starts within reach.

    Args:
        gas: All gas.
        pools: ID of the bright part of each voxel.
        down: Array axis of gravity and the direction along it.
        reach: Maximum distance [voxels].
    """
    axis, sense = down
    is_gut = np.zeros(int(gas.label.max()) + 1, bool)
    is_gut[[piece.label for piece in gas.gut]] = True
    above, below = (np.moveaxis(label, axis, 0)[::sense] for label in (gas.label, pools))
    depth, *column = np.nonzero(is_gut[above[:-1]] & (above[1:] == 0))
    piece = above[(depth, *column)].astype(int)
    pool, height = np.zeros(len(depth), int), depth.astype(float)
    for step in range(1, reach + 1):
        under = below[(np.minimum(depth + step, len(below) - 1), *column)]
        new = (pool == 0) & (under > 0)
        pool[new], height[new] = under[new], depth[new] + 0.5 * step
    if sense < 0:
        height = len(below) - 1 - height
    points = np.insert(np.array(column, float).T, axis, height, axis=1)
    pairs, which = np.unique(np.stack([piece, pool]), axis=1, return_inverse=True)
    return [
        AirFluidInterface(one, other, points[which.ravel() == number])
        for number, (one, other) in enumerate(pairs.T.tolist())
        if other > 0
    ]


def add_fluid(
    fraction: Float[np.ndarray, "k j i"],
    values: Int[np.ndarray, "k j i"],
    pools: Bool[np.ndarray, "k j i"],
    hounsfield: tuple[float, float],
) -> None:
    """Raise the lumen fraction, in place, where there is fluid.

    In and around fluid the fraction is linear from the wall's Hounsfield units to the fluid's.

    Args:
        fraction: Lumen fraction of the gas.
        values: Hounsfield units of the same voxels.
        pools: Voxels of the fluid.
        hounsfield: Hounsfield units of the wall and of the fluid.
    """
    tissue, fluid = hounsfield
    near = grown(pools, _SKIRT)
    wet = np.clip((values[near] - tissue) / (fluid - tissue), 0.0, 1.0)
    fraction[near] = np.maximum(fraction[near], wet)
