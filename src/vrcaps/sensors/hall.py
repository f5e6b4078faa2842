"""Array of three-axis Hall sensors: readings and calibration errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.magnet.field import field
from vrcaps.magnet.sources import Source

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
            raise InputError(f"Sensors of shape {shape}. Allowed: n rows of 3 finite numbers [m].")
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
