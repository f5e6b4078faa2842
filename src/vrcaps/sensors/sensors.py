"""Sensors of a recording: IMU and magnetometer in the capsule, Hall array under the patient."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from vrcaps.config.fields import Range, check_fields
from vrcaps.core.geometry import transform_from
from vrcaps.core.units import MM
from vrcaps.sensors.hall import HallArray, hall_grid
from vrcaps.sensors.imu import Imu, Magnetometer
from vrcaps.world.model import Model

EARTH_FIELD = (0.0, 20e-6, -45e-6)
"""Default magnetic field of the earth in the world [T]."""


@dataclass(frozen=True)
class HallPad:
    """Square of Hall sensors on the table under the patient.

    Attributes:
        width: Side length of the square [m].
        count: Number of sensors along a side.
        gap: Distance of the square below the lowest point of the wall at rest [m].
        range: Maximum absolute reading [T]; larger fields give no reading.
        gain_error: Standard deviation of each gain's calibration error, relative.
        offset_error: Standard deviation of each offset's calibration error [T].
    """

    width: Annotated[float, Range(above=0.0, below=math.inf)] = 0.35
    count: Annotated[int, Range(min=2)] = 8
    gap: Annotated[float, Range(above=-math.inf, below=math.inf)] = 50.0 * MM
    range: Annotated[float, Range(above=0.0)] = 50e-3
    gain_error: Annotated[float, Range(min=0.0, below=math.inf)] = 0.005
    offset_error: Annotated[float, Range(min=0.0, below=math.inf)] = 1e-6

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Sensors:
    """Sensors that are read once per frame; none by default.

    Attributes:
        imu: IMU in the capsule. A reading is the mean over the time between the adjacent frames,
            so that the unit's `rate` is the recording's.
        magnetometer: Magnetometer in the capsule; the capsule's own magnet is part of the unit's
            offset.
        hall: Hall sensors under the patient, which localize the capsule's magnet.
        earth_field: Magnetic field of the earth in the world [T].
    """

    imu: Imu | None = None
    magnetometer: Magnetometer | None = None
    hall: HallPad | None = None
    earth_field: tuple[float, float, float] = EARTH_FIELD

    def with_inertial(self) -> Sensors:
        """Return the sensors with an IMU and a magnetometer; missing ones have defaults."""
        return replace(
            self, imu=self.imu or Imu(), magnetometer=self.magnetometer or Magnetometer()
        )


def hall_array(pad: HallPad, model: Model) -> HallArray:
    """Sensors of a pad in the world, with their nominal gain and offset."""
    low, high = model.vertices_world.min(axis=0), model.vertices_world.max(axis=0)
    middle = 0.5 * (low + high)
    position = np.array([middle[0], middle[1], low[2] - pad.gap])
    grid = hall_grid(pad.width, pad.count, transform_from(np.eye(3), position))
    return replace(grid, range=pad.range)
