"""Lumen fraction of each voxel, from Hounsfield units or from a mask.

At an air-fluid interface, gas, tagged fluid and wall meet in a voxel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from vrcaps.core.units import MM
from vrcaps.tools.ct.cleansing import add_fluid
from vrcaps.tools.ct.lumen import SPECKS, connected_parts, grown, part_sizes, renumbered, shrunk
from vrcaps.tools.ct.volume import PatientGrid, shifted

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt16

    from vrcaps.tools.ct.cleansing import Fluid
    from vrcaps.tools.ct.lumen import Gas
    from vrcaps.tools.ct.volume import Volume

_HALF_LAYER = 2 * MM  # above and below an interface, where the scan's blur mixes gas and fluid
_BESIDE = 3  # columns next to the interface, where the wall's partial volume mixes with both
_MANY = 30  # minimum number of columns to measure the tilt of the interface against the grid
_BIN = 0.5  # bin width of the measured profile through an interface [voxels]
_KNOWN = 0.35  # content-wall over fluid-wall contrast below which neighbors decide
_NEAR = 0.7  # standard deviation of the weight of these neighbors [voxels]


def resolve_interface(
    fraction: Float[np.ndarray, "k j i"],
    values: Int[np.ndarray, "k j i"],
    points: Float[np.ndarray, "n 3"],
    *,
    axis: int,
    spacing: float,
    hounsfield: tuple[float, float],
) -> None:
    """Set the lumen fraction, in place, along an air-fluid interface.

    From gas to fluid the content C passes through the wall's Hounsfield units T without being
    wall. An interface is flat, so C is a function of the distance from it, measured away from the
    wall. A voxel with a fraction s of lumen has H = T + s (C − T). Where C is close to T, least
    squares over the neighbors is used: s = Σ (C − T)(H − T) / Σ (C − T)².

    Args:
        fraction: Lumen fraction.
        values: Hounsfield units of the same voxels.
        points: Array indices of the interface, one for each column (`AirFluidInterface`).
        axis: Array axis of gravity.
        spacing: Voxel spacing along this axis [m].
        hounsfield: Hounsfield units of the wall and of the fluid.
    """
    fraction, values = np.moveaxis(fraction, axis, 0), np.moveaxis(values, axis, 0)
    height, column = points[:, axis], np.delete(points, axis, axis=1).astype(int)
    own = np.zeros(fraction.shape[1:], bool)
    own[tuple(column.T)] = True
    half = max(2.0, _HALF_LAYER / spacing)
    square = np.ones((2 * _BESIDE + 1,) * 2, bool)
    patch = np.empty(own.shape, np.int32)
    ndimage.label(ndimage.binary_dilation(own, square), output=patch)
    for label, box in enumerate(ndimage.find_objects(patch), start=1):
        here = patch[tuple(column.T)] == label
        corner = [side.start for side in box]
        plane = _plane(column[here] - corner, height[here], patch[box].shape)
        low, high = int(plane.min() - half - 2), int(plane.max() + half + 3)
        slab = (slice(max(low, 0), high), *box)
        offset = (
            np.arange(slab[0].start, slab[0].start + len(fraction[slab]))[:, None, None] - plane
        )
        is_neighbor = patch[box] == label
        fractions = _fraction(values[slab], offset, own[box] & is_neighbor, hounsfield)
        layer = (np.abs(offset) <= half) & is_neighbor
        fraction[slab][layer] = fractions[layer]


def _plane(
    column: Int[np.ndarray, "n 2"], height: Float[np.ndarray, " n"], shape: tuple[int, ...]
) -> Float[np.ndarray, "a b"]:
    """Height of an interface in each column: a fitted plane, horizontal for a small interface."""
    rows, columns = np.indices(shape)
    if len(column) < _MANY:
        return np.full(shape, np.median(height))
    terms = np.column_stack([column, np.ones(len(column))])
    good = np.ones(len(column), bool)
    fit = np.zeros(3)
    for _ in range(3):
        fit = np.linalg.lstsq(terms[good], height[good], rcond=None)[0]
        away = np.abs(height - terms @ fit)
        good = away <= max(1.0, 2.0 * float(np.median(away)))
    return fit[0] * rows + fit[1] * columns + fit[2]


def _fraction(
    values: Int[np.ndarray, "d a b"],
    offset: Float[np.ndarray, "d a b"],
    own: Bool[np.ndarray, "a b"],
    hounsfield: tuple[float, float],
) -> Float[np.ndarray, "d a b"]:
    """Lumen fraction of the voxels around an interface.

    Args:
        values: Hounsfield units.
        offset: Distance along gravity from the interface [voxels].
        own: Columns that contain the interface.
        hounsfield: Hounsfield units of the wall and of the fluid.
    """
    tissue, fluid = hounsfield
    contrast = _profile(values, offset, own) - tissue
    both = contrast * (values - np.float32(tissue))
    square = contrast**2
    around = [ndimage.gaussian_filter(a, _NEAR, mode="nearest") for a in (both, square)]
    floor = (_KNOWN * (fluid - tissue)) ** 2
    near = around[0] / np.maximum(around[1], 1.0)
    return np.clip((both + floor * near) / (square + floor), 0.0, 1.0)


def _profile(
    values: Int[np.ndarray, "d a b"],
    offset: Float[np.ndarray, "d a b"],
    own: Bool[np.ndarray, "a b"],
) -> Float[np.ndarray, "d a b"]:
    """Hounsfield units of the content by its distance from the interface: medians of bins."""
    inner = np.asarray(ndimage.binary_erosion(own, iterations=2), bool)
    inner = inner if np.count_nonzero(inner) >= _MANY else own
    at = np.rint(offset[:, inner] / _BIN).astype(int).ravel()
    hounsfield = values[:, inner].ravel()
    order = np.argsort(at, kind="stable")
    bins, first = np.unique(at[order], return_index=True)
    medians = [np.median(part) for part in np.split(hounsfield[order], first[1:])]
    return np.interp(offset, bins * _BIN, medians).astype(np.float32)


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
    new_label = np.zeros(num + 1, int)
    new_label[order] = np.arange(1, len(order) + 1)
    return renumbered(label, new_label), volumes[order].tolist()


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
