"""How much of each voxel is lumen: from Hounsfield units, or from a mask."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from vrcaps.organ.ct.cleansing import cleansed_share
from vrcaps.organ.ct.parts import connected_parts
from vrcaps.organ.ct.volume import index_to_patient, shifted
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.organ.ct.cleansing import Fluid
    from vrcaps.organ.ct.lumen import Gas
    from vrcaps.organ.ct.volume import Volume

_MARGIN = 8 * MM
_NEIGHBOUR = 3  # voxels around another piece's core that it keeps for itself
_WALL = 3  # voxels around the lumen in which the level of tissue is measured
_TISSUE_RANGE = (-150, 150)  # Hounsfield units of what may be gut wall or fat
_TISSUE = 30.0  # Hounsfield units of a gut wall where none can be measured


@dataclass(frozen=True)
class LumenFraction:
    """The share of each voxel that is lumen, 0 to 1; the wall is where it is one half.

    Attributes:
        share: Over a box that reaches a little beyond the lumen, but for the scan's own ends.
        T_patient_index: Maps the array index of a voxel to its centre, patient frame [m].
    """

    share: Float[np.ndarray, "k j i"]
    T_patient_index: Float[np.ndarray, "4 4"]

    @property
    def spacing(self) -> Float[np.ndarray, " 3"]:
        """Distance of neighbouring voxels along the array's axes [m]."""
        return np.linalg.norm(self.T_patient_index[:3, :3], axis=0)

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel [m³]."""
        return float(abs(np.linalg.det(self.T_patient_index[:3, :3])))

    def points(self, index: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Positions [m] of array indices (k, j, i)."""
        return index_to_patient(self.T_patient_index, index)

    def crop(self, box: tuple[slice, ...]) -> LumenFraction:
        """The part in a box of array indices."""
        return LumenFraction(self.share[box], shifted(self.T_patient_index, box))


def gas_fraction(
    scan: Volume,
    gas: Gas,
    numbers: tuple[int, ...],
    *,
    fluid: Fluid | None = None,
    pools: tuple[int, ...] = (),
) -> LumenFraction:
    """Lumen fraction of pieces of gas: linear from the wall's Hounsfield units to the gas's.

    Both levels are measured: the median of the pieces' inner voxels, and of soft tissue within
    three voxels of them. What belongs to other pieces of gas is no lumen.

    Args:
        scan: Hounsfield units.
        gas: All gas in it.
        numbers: Of the pieces.
        fluid: Tagged fluid, where it belongs to the lumen (`cleansed_share`).
        pools: Numbers of the pools of fluid that do.
    """
    chosen = np.zeros(gas.label.max() + 1, bool)
    chosen[list(numbers)] = True
    is_lumen = chosen[gas.label]
    if fluid is not None:
        is_lumen |= np.isin(fluid.label, pools)
    box = margin_box(bounding_box(is_lumen), scan)
    label, part = gas.label[box], scan.crop(box)
    own = chosen[label]
    other = (label > 0) & ~own
    inner = ndimage.binary_erosion(own, iterations=2)
    level = float(np.median(part.values[inner])) if inner.sum() > 1000 else gas.hounsfield
    level = min(level, gas.hounsfield + 50.0)
    shell = ndimage.binary_dilation(own, iterations=_WALL) & (part.values > _TISSUE_RANGE[0])
    near = part.values[shell & (part.values < _TISSUE_RANGE[1])]
    tissue = float(np.median(near)) if len(near) > 1000 else _TISSUE
    share = (tissue - part.values).astype(np.float32)
    share *= np.float32(1.0 / (tissue - level))
    np.clip(share, 0.0, 1.0, out=share)
    if other.any():
        kept = ndimage.binary_dilation(own)
        share[ndimage.binary_dilation(other, iterations=_NEIGHBOUR) & ~kept] = 0.0
    if fluid is not None and pools:
        wet = np.isin(fluid.label[box], pools)
        levels = (tissue, fluid.hounsfield)
        share = cleansed_share(share, part.values, wet, own, levels, fluid.down)
    return LumenFraction(share, part.T_patient_index)


def mask_fraction(labels: Volume, numbers: tuple[int, ...]) -> LumenFraction | None:
    """Lumen fraction of some labels of a label map, 0 or 1; None where there is no such voxel."""
    box = bounding_box(np.isin(labels.values, numbers))
    if any(part.stop <= part.start for part in box):
        return None
    part = labels.crop(margin_box(box, labels))
    return LumenFraction(np.isin(part.values, numbers).astype(np.float32), part.T_patient_index)


def drop_strays(
    lumen: LumenFraction, min_volume: float
) -> tuple[LumenFraction, Int[np.ndarray, "k j i"], list[float]]:
    """The lumen without connected parts (by faces) smaller than a volume.

    Args:
        lumen: The lumen fraction.
        min_volume: Smallest part to keep [m³].

    Returns:
        The cleaned lumen, the number of the part of each voxel (1 for the largest, 0 for none),
        and the parts' volumes [m³], largest first.
    """
    label, num = connected_parts(lumen.share > 0.5)
    counts = np.bincount(label.ravel(), minlength=num + 1)
    counts[0] = 0
    order = [n for n in np.argsort(-counts) if counts[n] * lumen.voxel_volume >= min_volume]
    number = np.full(num + 1, -1)
    number[0] = 0
    number[order] = np.arange(1, len(order) + 1)
    part = number.astype(np.int32)[label]
    share = np.where(part < 0, np.float32(0.0), lumen.share)
    volumes = [float(counts[n] * lumen.voxel_volume) for n in order]
    return replace(lumen, share=share), np.maximum(part, 0), volumes


def bounding_box(mask: Bool[np.ndarray, "k j i"]) -> tuple[slice, slice, slice]:
    """The smallest box around what is true."""
    ranges = []
    for axis in range(3):
        used = mask.any(axis=tuple(other for other in range(3) if other != axis))
        ids = np.flatnonzero(used)
        ranges.append(slice(int(ids[0]), int(ids[-1]) + 1) if len(ids) else slice(0, 0))
    return ranges[0], ranges[1], ranges[2]


def margin_box(box: tuple[slice, slice, slice], scan: Volume) -> tuple[slice, slice, slice]:
    """A box with room for the wall around it, as far as the scan goes."""
    pads = np.ceil(_MARGIN / scan.spacing).astype(int).tolist()
    wider = [
        slice(max(0, part.start - pad), min(size, part.stop + pad))
        for part, size, pad in zip(box, scan.values.shape, pads, strict=True)
    ]
    return wider[0], wider[1], wider[2]
