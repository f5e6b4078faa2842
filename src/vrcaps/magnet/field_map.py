"""Reader of field maps, sampled on a regular grid, from NPZ and CSV files."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, reading
from vrcaps.core.files import read_arrays
from vrcaps.core.units import parse_length
from vrcaps.magnet.sources import FieldMap

FLUX_UNITS = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "G": 1e-4}
"""Supported units of flux density, in tesla."""
_COLUMNS = ("x", "y", "z", "bx", "by", "bz")
_REGULAR = 1e-6
_MIN_POINTS = 4


def read_field_map(path: str | Path, *, length_unit: str, flux_unit: str) -> FieldMap:
    """Read a field map from an NPZ or CSV file.

    An NPZ contains the axes `x`, `y`, `z` (one-dimensional, evenly spaced, ascending) and
    `flux_density` [nx ny nz 3]. A CSV has a header with the columns x, y, z, bx, by, bz in any
    order, and one row for each point of a regular grid, in any order.

    Args:
        path: The file.
        length_unit: Unit of its positions: m, dm, cm, mm, um.
        flux_unit: Unit of its values: T, mT, uT, G.

    Raises:
        UnknownNameError: If the unit of flux density is unknown.
        InputError: If the file cannot be read, is incomplete, or is not a regular grid.
    """
    path = Path(path)
    if flux_unit not in FLUX_UNITS:
        raise UnknownNameError("unit of flux density", flux_unit, FLUX_UNITS)
    length = parse_length(length_unit)
    readers = {".npz": _read_npz, ".csv": _read_csv}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path}: unknown kind of field map. Allowed: {', '.join(readers)}.")
    with reading(f"the field map {path}"):
        axes, values = readers[path.suffix.lower()](path)
    for name, axis in zip("xyz", axes, strict=True):
        _check_axis(path, name, axis)
    if not np.isfinite(values).all():
        raise InputError(f"{path} contains a flux density that is not finite.")
    return FieldMap(
        tuple(length * axis[0] for axis in axes),
        tuple(length * (axis[-1] - axis[0]) / (len(axis) - 1) for axis in axes),
        np.ascontiguousarray(values, float) * FLUX_UNITS[flux_unit],
    )


def _check_axis(path: Path, name: str, axis: np.ndarray) -> None:
    if axis.ndim != 1 or len(axis) < _MIN_POINTS:
        raise InputError(
            f"{path}: axis {name} has shape {axis.shape}. Allowed: {_MIN_POINTS} or more points."
        )
    even = np.linspace(axis[0], axis[-1], len(axis))
    step = (axis[-1] - axis[0]) / (len(axis) - 1)
    if not (step > 0.0 and np.abs(axis - even).max() <= _REGULAR * step):
        raise InputError(
            f"{path}: axis {name} is not evenly spaced and rising. Sample it on a regular grid."
        )


def _read_npz(path: Path) -> tuple[list[np.ndarray], np.ndarray]:
    try:
        arrays = read_arrays(path)
        axes = [np.asarray(arrays[name], float) for name in "xyz"]
        values = np.asarray(arrays["flux_density"], float)
    except KeyError as error:
        raise InputError(
            f"{path} has no array {error}. Allowed: arrays x, y, z and flux_density."
        ) from error
    except ValueError as error:
        raise InputError(f"{path} is no NPZ file of numbers: {error}.") from error
    shape = tuple(axis.size for axis in axes)
    if values.shape != (*shape, 3):
        raise InputError(
            f"{path}: flux_density has shape {values.shape}. Allowed: {(*shape, 3)}, as its axes."
        )
    return axes, values


def _read_csv(path: Path) -> tuple[list[np.ndarray], np.ndarray]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        names = [name.strip().lower() for name in next(reader, [])]
        if sorted(names) != sorted(_COLUMNS):
            raise InputError(f"{path}: columns {names}. Allowed: {', '.join(_COLUMNS)}.")
        try:
            rows = np.array([[float(x) for x in row] for row in reader], float)
        except ValueError as error:
            raise InputError(f"{path}: {error}. Allowed: numbers, six to a row.") from error
    if rows.ndim != 2 or rows.shape[1] != len(_COLUMNS):
        raise InputError(f"{path}: no rows of six numbers after the header.")
    table = rows[:, [names.index(name) for name in _COLUMNS]]
    axes = [np.unique(table[:, k]) for k in range(3)]
    shape = tuple(len(axis) for axis in axes)
    indices = tuple(np.searchsorted(axes[k], table[:, k]) for k in range(3))
    filled = np.unique(np.ravel_multi_index(indices, shape)).size
    if not len(table) == filled == np.prod(shape):
        raise InputError(
            f"{path}: {len(table)} rows, {filled} different points, do not fill a grid of "
            f"{shape[0]} x {shape[1]} x {shape[2]}. Give each point of a regular grid once."
        )
    values = np.empty((*shape, 3))
    values[indices] = table[:, 3:]
    return axes, values
