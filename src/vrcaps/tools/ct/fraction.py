"""Lumen fraction of each voxel, from Hounsfield units or from a mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM
from vrcaps.tools.ct.air_fluid_interface import resolve_interface
from vrcaps.tools.ct.cleansing import add_fluid
from vrcaps.tools.ct.components import connected_parts, grown, part_sizes, renumbered, shrunk
from vrcaps.tools.ct.lumen import SPECKS
from vrcaps.tools.ct.volume import PatientGrid, shifted

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt16

    from vrcaps.tools.ct.cleansing import Fluid
    from vrcaps.tools.ct.lumen import Gas
    from vrcaps.tools.ct.volume import Volume

_MARGIN = 8 * MM
_NEIGHBOR = 3  # voxels around the core of another piece that belong to that piece
_WALL = 3  # voxels around the lumen in which the tissue's Hounsfield units are measured
_TISSUE_RANGE = (-150, 150)  # range of Hounsfield units of gut wall or fat
_TISSUE = 30.0  # default Hounsfield units of a gut wall that cannot be measured


@dataclass(frozen=True)
class LumenFraction(PatientGrid):
    """Fraction of each voxel that is lumen, 0 to 1; the wall is its isosurface at one half.

    Attributes:
        fraction: Over a box with a small margin around the lumen, except at the scan's own ends.
        T_patient_index: Maps the array index of a voxel to its center, patient frame [m].
    """

    fraction: Float[np.ndarray, "k j i"]
    T_patient_index: Float[np.ndarray, "4 4"]

    def crop(self, box: tuple[slice, ...]) -> LumenFraction:
        """Crop to a box of array indices."""
        return LumenFraction(self.fraction[box], shifted(self.T_patient_index, box))


def gas_fraction(
    scan: Volume,
    gas: Gas,
    numbers: tuple[int, ...],
    *,
    fluid: Fluid | None = None,
    pools: tuple[int, ...] = (),
) -> LumenFraction:
    """Lumen fraction of pieces of gas: linear from the wall's Hounsfield units to the gas's.

    Both values are measured: the median of the pieces' inner voxels, and of soft tissue within
    three voxels of them. Voxels of other pieces of gas are not lumen.

    Args:
        scan: Hounsfield units.
        gas: All gas in it.
        numbers: IDs of the pieces.
        fluid: Tagged fluid, if it belongs to the lumen (`add_fluid`, `resolve_interface`).
        pools: IDs of the pools of fluid that belong to the lumen.
    """
    box = margin_box(_lumen_box(gas, numbers, fluid, pools), scan)
    label, part = gas.label[box], scan.crop(box)
    own = np.isin(label, numbers)
    inner = part.values[shrunk(own, 2)]
    content = float(np.median(inner)) if len(inner) > 1000 else gas.hounsfield
    content = min(content, gas.hounsfield + 50.0)
    shell = grown(own, _WALL) & (part.values > _TISSUE_RANGE[0]) & (part.values < _TISSUE_RANGE[1])
    near = part.values[shell]
    tissue = float(np.median(near)) if len(near) > 1000 else _TISSUE
    fraction = part.values.astype(np.float32)
    fraction -= np.float32(tissue)
    fraction *= np.float32(1.0 / (content - tissue))
    np.clip(fraction, 0.0, 1.0, out=fraction)
    if fluid is not None and pools:
        hounsfield = (tissue, fluid.hounsfield)
        add_fluid(fraction, part.values, np.isin(fluid.label[box], pools), hounsfield)
        corner = [side.start for side in box]
        for interface in fluid.interfaces:
            if interface.pool in pools:
                resolve_interface(
                    fraction,
                    part.values,
                    interface.points - corner,
                    axis=fluid.axis,
                    spacing=float(scan.spacing[fluid.axis]),
                    hounsfield=hounsfield,
                )
    other = (label > 0) & (label != SPECKS) & ~own
    if other.any():
        fraction[grown(other, _NEIGHBOR) & ~grown(own)] = 0.0
    return LumenFraction(fraction, part.T_patient_index)


def _lumen_box(
    gas: Gas, numbers: tuple[int, ...], fluid: Fluid | None, pools: tuple[int, ...]
) -> tuple[slice, slice, slice]:
    """Bounding box of pieces of gas and pools of fluid."""
    is_lumen = np.isin(gas.label, numbers)
    if fluid is not None and pools:
        is_lumen |= np.isin(fluid.label, pools)
    return bounding_box(is_lumen)


def mask_fraction(labels: Volume, numbers: tuple[int, ...]) -> LumenFraction | None:
    """Lumen fraction of some labels of a label map, 0 or 1; None if there is no such voxel."""
    box = bounding_box(np.isin(labels.values, numbers))
    if any(part.stop <= part.start for part in box):
        return None
    part = labels.crop(margin_box(box, labels))
    return LumenFraction(np.isin(part.values, numbers).astype(np.float32), part.T_patient_index)


def number_parts(
    lumen: LumenFraction, min_volume: float
) -> tuple[UInt16[np.ndarray, "k j i"], list[float]]:
    """Label the parts (connected by faces) of a lumen of at least a given volume [m³].

    Returns:
        The ID of the part of each voxel (1 for the largest, 0 for none), and the parts'
        volumes [m³] in descending order.
    """
    label, num = connected_parts(lumen.fraction > 0.5)
    volumes = part_sizes(label, num) * lumen.voxel_volume
    volumes[0] = 0.0
    order = np.argsort(-volumes, kind="stable")
    order = order[volumes[order] >= min_volume]
    number = np.zeros(num + 1, int)
    number[order] = np.arange(1, len(order) + 1)
    return renumbered(label, number), volumes[order].tolist()


def bounding_box(mask: Bool[np.ndarray, "k j i"]) -> tuple[slice, slice, slice]:
    """Bounding box of a mask."""
    ranges = []
    for axis in range(3):
        used = mask.any(axis=tuple(other for other in range(3) if other != axis))
        ids = np.flatnonzero(used)
        ranges.append(slice(int(ids[0]), int(ids[-1]) + 1) if len(ids) else slice(0, 0))
    return ranges[0], ranges[1], ranges[2]


def margin_box(box: tuple[slice, slice, slice], scan: Volume) -> tuple[slice, slice, slice]:
    """Box with a margin for the wall, clipped to the scan."""
    pads = np.ceil(_MARGIN / scan.spacing).astype(int).tolist()
    wider = [
        slice(max(0, part.start - pad), min(size, part.stop + pad))
        for part, size, pad in zip(box, scan.values.shape, pads, strict=True)
    ]
    return wider[0], wider[1], wider[2]
