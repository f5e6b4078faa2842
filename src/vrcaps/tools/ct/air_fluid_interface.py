"""Lumen fraction at an air-fluid interface, where gas, tagged fluid and wall meet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

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
    for number, box in enumerate(ndimage.find_objects(patch), start=1):
        here = patch[tuple(column.T)] == number
        corner = [side.start for side in box]
        plane = _plane(column[here] - corner, height[here], patch[box].shape)
        low, high = int(plane.min() - half - 2), int(plane.max() + half + 3)
        slab = (slice(max(low, 0), high), *box)
        offset = (
            np.arange(slab[0].start, slab[0].start + len(fraction[slab]))[:, None, None] - plane
        )
        beside = patch[box] == number
        found = _fraction(values[slab], offset, own[box] & beside, hounsfield)
        layer = (np.abs(offset) <= half) & beside
        fraction[slab][layer] = found[layer]


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
