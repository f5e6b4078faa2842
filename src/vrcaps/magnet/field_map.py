"""Reader of field maps, sampled on a regular grid, from NPZ and CSV files."""

from __future__ import annotations

import csv
import math
from itertools import islice
from pathlib import Path

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, reading
from vrcaps.core.files import read_arrays
from vrcaps.core.units import LENGTH_UNITS, parse_length
from vrcaps.magnet.sources import FieldMap

FLUX_UNITS = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "G": 1e-4}
"""Supported units of flux density, in tesla."""
_COLUMNS = ("x", "y", "z", "bx", "by", "bz")
_VALUES = "flux_density"
_STRONGEST = 20.0
"""Maximum flux density [T]; more is a wrong unit."""
_MAX_POINTS = 2**24
_Units = tuple[set[str], set[str]]
"""Units of length and of flux density that the names of a file state."""
_REGULAR = 1e-6
_MIN_POINTS = 4


def read_field_map(path: str | Path, *, length_unit: str = "", flux_unit: str = "") -> FieldMap:
    """Read a field map from an NPZ or CSV file.

    An NPZ contains the axes `x`, `y`, `z` (one-dimensional, evenly spaced, ascending) and
    `flux_density` [nx ny nz 3]. A CSV has a header with the columns x, y, z, bx, by, bz in any
    order, and one row for each point of a regular grid, in any order. All names carry their unit,
    such as `x_mm`, `bx_mT` or `flux_density_mT`, or none does and the units are arguments.

    Args:
        path: The file.
        length_unit: Unit of its positions, if the file states none: m, dm, cm, mm, um.
        flux_unit: Unit of its values, if the file states none: T, mT, uT, G.

    Raises:
        UnknownNameError: If the unit of flux density is unknown.
        InputError: If the file cannot be read, is incomplete, states no unit or several, or is not
            a regular grid.
    """
    path = Path(path)
    if flux_unit and flux_unit not in FLUX_UNITS:
        raise UnknownNameError("unit of flux density", flux_unit, FLUX_UNITS)
    readers = {".npz": _read_npz, ".csv": _read_csv}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path}: unknown kind of field map. Allowed: {', '.join(readers)}.")
    with reading(f"the field map {path}"):
        axes, values, units = readers[path.suffix.lower()](path)
    length_unit, flux_unit = _stated(path, units, (length_unit, flux_unit))
    length = parse_length(length_unit)
    for name, axis in zip("xyz", axes, strict=True):
        _check_axis(path, name, axis)
    if not np.isfinite(values).all():
        raise InputError(f"{path} contains a flux density that is not finite.")
    if not (strongest := float(np.abs(values).max()) * FLUX_UNITS[flux_unit]) <= _STRONGEST:
        raise InputError(
            f"{path} has a flux density of {strongest:.3g} T. Allowed: up to {_STRONGEST:g} T; "
            f"check the unit, {flux_unit}."
        )
    return FieldMap(
        tuple(length * axis[0] for axis in axes),
        tuple(length * (axis[-1] - axis[0]) / (len(axis) - 1) for axis in axes),
        np.ascontiguousarray(values, float) * FLUX_UNITS[flux_unit],
    )


def _split_unit(name: str) -> tuple[str, str]:
    """Name in lower case without its unit, and the unit; an unknown name is unchanged."""
    for known in (_VALUES, *reversed(_COLUMNS)):
        if name.lower() == known or name.lower().startswith(f"{known}_"):
            return known, name[len(known) + 1 :]
    return name.lower(), ""


def _stated(path: Path, units: _Units, given: tuple[str, str]) -> tuple[str, str]:
    """Units of length and flux density, of the file or as given.

    Raises:
        InputError: If there is none or more than one, or the file states other units than given.
    """
    known = (LENGTH_UNITS, FLUX_UNITS)
    stated = []
    for what, own, argument, names in zip(
        ("length", "flux density"), units, given, known, strict=True
    ):
        named = own | ({argument} if argument else set())
        if len(named) != 1 or "" in named:
            listed = ", ".join(sorted(unit or "none" for unit in named)) or "none"
            raise InputError(
                f"{path}: units of {what}: {listed}. Allowed: one of {', '.join(names)}, in the "
                "names of all columns, such as x_mm and bx_mT."
            )
        unit = named.pop()
        if own and unit not in names:
            raise InputError(f"{path}: unit of {what} {unit!r}. Allowed: {', '.join(names)}.")
        stated.append(unit)
    return stated[0], stated[1]


def _check_axis(path: Path, name: str, axis: np.ndarray) -> None:
    if axis.ndim != 1 or len(axis) < _MIN_POINTS:
        raise InputError(
            f"{path}: axis {name} has shape {axis.shape}. Allowed: {_MIN_POINTS} or more points."
        )
    even = np.linspace(axis[0], axis[-1], len(axis))
    step = (axis[-1] - axis[0]) / (len(axis) - 1)
    if not (step > 0.0 and np.abs(axis - even).max() <= _REGULAR * step):
        raise InputError(
            f"{path}: axis {name} is not evenly spaced and ascending. Sample it on a regular grid."
        )


def _read_npz(path: Path) -> tuple[list[np.ndarray], np.ndarray, _Units]:
    try:
        stored = read_arrays(path)
        arrays = {_split_unit(name)[0]: array for name, array in stored.items()}
        units = {_split_unit(name) for name in stored}
        axes = [np.asarray(arrays[name], float) for name in "xyz"]
        values = np.asarray(arrays[_VALUES], float)
    except KeyError as error:
        raise InputError(
            f"{path} has no array {error}. Allowed: arrays x, y, z and flux_density, with their "
            "units, such as x_mm and flux_density_mT."
        ) from error
    except ValueError as error:
        raise InputError(f"{path} is not an NPZ file of numbers: {error}.") from error
    shape = tuple(axis.size for axis in axes)
    if values.shape != (*shape, 3):
        raise InputError(
            f"{path}: flux_density has shape {values.shape}. Allowed: {(*shape, 3)}, as its axes."
        )
    return axes, values, _sorted_units(units)


def _sorted_units(units: set[tuple[str, str]]) -> _Units:
    """Units of positions and of values; empty if no name states one."""
    if not any(unit for _, unit in units):
        return set(), set()
    lengths = {unit for name, unit in units if name in ("x", "y", "z")}
    return lengths, {unit for name, unit in units if name in (*_COLUMNS[3:], _VALUES)}


def _read_csv(path: Path) -> tuple[list[np.ndarray], np.ndarray, _Units]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        header = [_split_unit(name.strip()) for name in next(reader, [])]
        names = [name for name, _ in header]
        if sorted(names) != sorted(_COLUMNS):
            raise InputError(
                f"{path}: columns {names}. Allowed: {', '.join(_COLUMNS)}, with their units, such "
                "as x_mm and bx_mT."
            )
        try:
            rows = np.array([[float(x) for x in row] for row in islice(reader, _MAX_POINTS)], float)
        except ValueError as error:
            raise InputError(f"{path}: {error}. Allowed: numbers, six to a row.") from error
    if rows.ndim != 2 or rows.shape[1] != len(_COLUMNS):
        raise InputError(f"{path}: no rows of six numbers after the header.")
    table = rows[:, [names.index(name) for name in _COLUMNS]]
    axes = [np.unique(table[:, k]) for k in range(3)]
    shape = tuple(len(axis) for axis in axes)
    if math.prod(shape) != len(table):
        raise _not_a_grid(path, len(table), len(np.unique(table[:, :3], axis=0)), shape)
    indices = tuple(np.searchsorted(axes[k], table[:, k]) for k in range(3))
    filled = np.unique(np.ravel_multi_index(indices, shape)).size
    if filled != len(table):
        raise _not_a_grid(path, len(table), filled, shape)
    values = np.empty((*shape, 3))
    values[indices] = table[:, 3:]
    return axes, values, _sorted_units(set(header))


def _not_a_grid(path: Path, rows: int, points: int, shape: tuple[int, ...]) -> InputError:
    return InputError(
        f"{path}: {rows} rows, {points} different points, do not fill a grid of "
        f"{shape[0]} x {shape[1]} x {shape[2]}. Give each point of a regular grid once."
    )
