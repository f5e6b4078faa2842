"""Array of three-axis Hall sensors: readings, calibration errors, and localization of a magnet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.magnet.field import field
from vrcaps.magnet.sources import MAGNETIC_CONSTANT, Cylinder, Dipole, Source, magnet_pose

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class HallArray:
    """Hall sensors at fixed positions in the world, with axes parallel to the world's.

    A reading is ``gain · B + offset + noise``, rounded to the resolution; beyond its
    range it is NaN.

    Attributes:
        positions_world: Positions of the sensors [m].
        noise: Standard deviation of a reading [T].
        resolution: Step of a reading [T]; 0 for no rounding.
        range: Maximum absolute reading [T].
        gain: Reading per flux density; 1 if calibrated.
        offset: Reading without a field [T].
    """

    positions_world: Float[np.ndarray, "n 3"]
    noise: float = 0.5e-6
    resolution: float = 0.15e-6
    range: float = 50e-3
    gain: float | Float[np.ndarray, "n 3"] = 1.0
    offset: float | Float[np.ndarray, "n 3"] = 0.0

    def __post_init__(self) -> None:
        shape = np.shape(self.positions_world)
        if len(shape) != 2 or shape[1] != 3 or not np.isfinite(self.positions_world).all():
            raise InputError(
                f"Sensors have shape {shape}. Allowed: n rows of 3 finite numbers [m]."
            )
        for name in ("noise", "resolution"):
            value = getattr(self, name)
            require(0.0 <= value < np.inf, f"HallArray {name}", value, "0 or more")
        require(self.range > 0.0, "HallArray range", self.range, "above 0")


def hall_grid(
    width: float, count: int, T_world_array: Float[np.ndarray, "4 4"] | None = None
) -> HallArray:
    """Square of `count` by `count` sensors, `width` [m] across, in the plane z = 0 of its frame.

    Raises:
        InputError: If the width is not above 0 or there are fewer than 2 by 2 sensors.
    """
    require(0.0 < width < np.inf, "A Hall array's width", width, "above 0")
    require(count >= 2, "A Hall array's count", count, "2 or more")
    line = np.linspace(-0.5 * width, 0.5 * width, count)
    x, y = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
    pose = np.eye(4) if T_world_array is None else np.asarray(T_world_array, float)
    flat = np.stack([x, y, np.zeros_like(x)], axis=-1)
    return HallArray(flat @ pose[:3, :3].T + pose[:3, 3])


def perturb_calibration(
    array: HallArray, rng: np.random.Generator, *, gain: float = 0.005, offset: float = 1e-6
) -> HallArray:
    """Return the array with calibration errors of gain and offset, drawn once.

    Args:
        array: The array with its nominal gain and offset.
        rng: Random number generator of the errors.
        gain: Standard deviation of each component's gain, relative.
        offset: Standard deviation of each component's offset [T].

    Raises:
        InputError: If a standard deviation is negative or not finite.
    """
    for name, error in (("gain", gain), ("offset", offset)):
        require(0.0 <= error < np.inf, f"A Hall array's error of {name}", error, "0 or more")
    shape = np.shape(array.positions_world)
    return replace(
        array,
        gain=array.gain * (1.0 + gain * rng.normal(size=shape)),
        offset=array.offset + offset * rng.normal(size=shape),
    )


def read_hall(
    array: HallArray, sources: Sequence[Source], rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Readings [T] of the array in the field of all sources.

    Raises:
        InputError: If a sensor lies in a dipole or on a wire or rim.
    """
    flux = field(sources, array.positions_world)[0]
    reading = array.gain * flux + array.offset + array.noise * rng.normal(size=flux.shape)
    if array.resolution > 0.0:
        reading = array.resolution * np.round(reading / array.resolution)
    return np.where(np.abs(reading) <= array.range, reading, np.nan)


_MAX_ITERATIONS = 50
_CONVERGED = 1e-9
"""Maximum component of the step at convergence, in its units."""
_LENGTH = 0.01
"""Unit of position in a step [m], so that all columns of the Jacobian have similar magnitude."""
_FLUX = 1e-6
"""Unit of the background in a step [T]."""
_MIN_READINGS = 8
"""Minimum number of readings: the 8 unknowns are position, direction and background."""
_DAMPING = 1e-4
"""Initial damping of the Levenberg-Marquardt method."""
_MAX_DAMPING = 1e8


@dataclass(frozen=True)
class PoseEstimate:
    """Estimated pose of a magnet and its uncertainty.

    It excludes the rotation about the magnet's own axis, which changes no reading.

    Attributes:
        T_world_magnet: Pose; +z along its moment.
        background: Estimated uniform background field [T].
        residual: Root mean square residual of the readings [T].
        covariance: Covariance of position [m] and of rotations about the world's axes [rad], from
            that residual.
    """

    T_world_magnet: Float[np.ndarray, "4 4"]
    background: Float[np.ndarray, " 3"]
    residual: float
    covariance: Float[np.ndarray, "6 6"]


def localize(
    array: HallArray,
    readings: Float[np.ndarray, "n 3"],
    magnet: Dipole | Cylinder,
    *,
    known: Sequence[Source] = (),
    start: Float[np.ndarray, "4 4"] | None = None,
    depths: tuple[float, float] = (0.03, 0.30),
) -> PoseEstimate:
    """Pose of a magnet of known moment in a uniform background, by nonlinear least squares.

    Minimizes Σ |B(x_i) + b − reading_i|² over position, direction and background b (Levenberg
    1944, Marquardt 1963). With the exact gradient G of the field: moving the magnet changes B by
    −G, rotating it by ω about its center p by ω × B − G (ω × (x − p)). Without a start, a grid of
    positions in front of the array is searched, where moment and background are linear unknowns.

    Args:
        array: The array; its calibrated gain and offset are removed.
        readings: Readings [T]; NaN is ignored.
        magnet: The magnet; its pose is ignored.
        known: Sources whose field is known and subtracted, such as the steering magnet.
        start: A nearby pose, such as the last estimate.
        depths: Minimum and maximum distance of the grid from the array's plane [m], on either
            side.

    Raises:
        InputError: If there are fewer than 8 finite readings, or shapes differ.
    """
    positions = np.asarray(array.positions_world, float)
    readings = (np.asarray(readings, float) - array.offset) / array.gain
    if readings.shape != positions.shape:
        raise InputError(f"Readings have shape {readings.shape}. Allowed: {positions.shape}.")
    if np.isfinite(readings).sum() < _MIN_READINGS:
        raise InputError(
            f"{np.isfinite(readings).sum()} finite readings. Allowed: {_MIN_READINGS} or more; the "
            "others are beyond the sensors' range."
        )
    if known:
        readings = readings - field(known, positions)[0]
    pose = _search(positions, readings, depths) if start is None else np.asarray(start, float)
    return _levenberg_marquardt(positions, readings, replace(magnet, T_world_magnet=pose))


def _levenberg_marquardt(
    positions: np.ndarray, readings: np.ndarray, magnet: Dipole | Cylinder
) -> PoseEstimate:
    """Levenberg-Marquardt iterations from the magnet's pose."""
    used = np.isfinite(readings).ravel()
    background = np.nanmean(readings - field([magnet], positions)[0], axis=0)
    rest, rows = _model(positions, readings, magnet, background)
    damping = _DAMPING
    for _ in range(_MAX_ITERATIONS):
        square = rows[used].T @ rows[used]
        slope = rows[used].T @ rest[used]
        step = np.linalg.solve(square + damping * np.diag(np.diag(square) + 1e-30), -slope)
        moved = _moved(magnet, step)
        trial = background + _FLUX * step[6:]
        new_rest, new_rows = _model(positions, readings, moved, trial)
        if np.sum(new_rest[used] ** 2) <= np.sum(rest[used] ** 2):
            magnet, background, rest, rows = moved, trial, new_rest, new_rows
            damping *= 0.1
            if np.abs(step[:6]).max() < _CONVERGED:
                break
        else:
            damping *= 10.0
            if damping > _MAX_DAMPING:
                break
    freedom = max(int(used.sum()) - 8, 1)
    variance = float(np.sum(rest[used] ** 2)) / freedom
    spread = variance * np.linalg.pinv(rows[used].T @ rows[used], rcond=1e-12, hermitian=True)
    length = np.concatenate([np.full(3, _LENGTH), np.ones(3)])
    covariance = spread[:6, :6] * np.outer(length, length)
    residual = float(np.sqrt(np.mean(rest[used] ** 2)))
    return PoseEstimate(np.asarray(magnet.T_world_magnet), background, residual, covariance)


def _model(
    positions: np.ndarray, readings: np.ndarray, magnet: Dipole | Cylinder, background: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals [3n] and Jacobian [3n 9] by position [10 mm], rotation [rad], background [µT]."""
    flux, by_place, by_turn = magnet_readings(positions, magnet)
    even = np.broadcast_to(_FLUX * np.eye(3), by_place.shape)
    rows = np.concatenate([_LENGTH * by_place, by_turn, even], axis=-1)
    return (flux + background - readings).ravel(), rows.reshape(-1, 9)


def magnet_readings(
    positions: Float[np.ndarray, "n 3"], magnet: Dipole | Cylinder
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3 3"]]:
    """Flux density of a magnet at positions [T], and its derivatives by the magnet's pose.

    Returns:
        Flux density, its Jacobian by the magnet's position [T/m], and that by its rotation about
        the world's axes through its center [T/rad].
    """
    flux, gradient = field([magnet], positions)
    arms = positions - magnet.T_world_magnet[:3, 3]
    turns = [
        np.cross(e, flux) - (gradient @ np.cross(e, arms)[..., None])[..., 0] for e in np.eye(3)
    ]
    return flux, -gradient, np.stack(turns, axis=-1)


def _moved(magnet: Dipole | Cylinder, step: np.ndarray) -> Dipole | Cylinder:
    pose = np.array(magnet.T_world_magnet)
    angle = np.linalg.norm(step[3:6])
    axis = step[3:6] / angle if angle > 0.0 else step[3:6]
    cross = np.cross(axis, np.eye(3)).T
    turn = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    u, _, v = np.linalg.svd(turn @ pose[:3, :3])
    pose[:3, :3] = u @ v
    pose[:3, 3] += _LENGTH * step[:3]
    return replace(magnet, T_world_magnet=pose)


def _search(positions: np.ndarray, readings: np.ndarray, depths: tuple[float, float]) -> np.ndarray:
    """Best pose on a grid on both sides of the array, with its best estimate and background."""
    used = np.isfinite(readings).ravel()
    center = positions.mean(axis=0)
    axes = np.linalg.svd(positions - center)[2]
    flat = (positions - center) @ axes.T
    reach = np.abs(flat[:, :2]).max(axis=0)
    heights = np.geomspace(*depths, 6)
    grid = np.meshgrid(
        np.linspace(-reach[0], reach[0], 9),
        np.linspace(-reach[1], reach[1], 9),
        np.concatenate([-heights, heights]),
        indexing="ij",
    )
    best, pose = np.inf, np.eye(4)
    for position in np.stack(grid, axis=-1).reshape(-1, 3) @ axes + center:
        arms = positions - position
        length = np.linalg.norm(arms, axis=1)[:, None, None]
        outer = arms[:, :, None] * arms[:, None, :] / length**2
        rows = MAGNETIC_CONSTANT / (4.0 * np.pi) * (3.0 * outer - np.eye(3)) / length**3
        rows = np.concatenate([rows, np.broadcast_to(_FLUX * np.eye(3), rows.shape)], axis=-1)
        rows = rows.reshape(-1, 6)[used]
        estimate, *_ = np.linalg.lstsq(rows, readings.ravel()[used], rcond=None)
        error = float(np.sum((rows @ estimate - readings.ravel()[used]) ** 2))
        if error < best and estimate[:3].any():
            best, pose = error, magnet_pose(position, estimate[:3])
    return pose
