"""Sensors of a recording: IMU and magnetometer in the capsule, Hall array under the patient."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import transform_from
from vrcaps.core.units import DEG, MM
from vrcaps.sensors.hall import HallArray, hall_grid
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float


_STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class CapsuleKinematics:
    """Rigid-body motion of a capsule about its origin, in the world.

    Attributes:
        R_world_capsule: Rotation.
        acceleration: Acceleration of the origin [m/s²].
        angular_velocity: Angular velocity [rad/s].
        angular_acceleration: Angular acceleration [rad/s²].
        gravity: Gravity [m/s²].
    """

    R_world_capsule: Float[np.ndarray, "3 3"]
    acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angular_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angular_acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = (0.0, 0.0, -_STANDARD_GRAVITY)


@dataclass(frozen=True)
class Imu:
    """Accelerometer and gyroscope with white noise and random-walk bias (IEEE Std 952-1997).

    The defaults are those of a small MEMS unit: noise from the data sheet of Bosch's BMI270; the
    random walk of the bias is assumed.

    Attributes:
        position_capsule: Position in the capsule [m]; its axes are the capsule's.
        rate: Readings per second [Hz].
        accelerometer_noise: Noise density [m/s²/√Hz].
        gyroscope_noise: Noise density [rad/s/√Hz].
        accelerometer_walk: Random walk of the bias [m/s²/√s].
        gyroscope_walk: Random walk of the bias [rad/s/√s].
        accelerometer_range: Maximum reading [m/s²]; larger values are clipped.
        gyroscope_range: Maximum reading [rad/s]; larger values are clipped.
    """

    position_capsule: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate: Annotated[float, Range(above=0.0, below=np.inf, unit="Hz")] = 100.0
    accelerometer_noise: Annotated[float, Range(min=0.0, below=np.inf)] = 160e-6 * _STANDARD_GRAVITY
    gyroscope_noise: Annotated[float, Range(min=0.0, below=np.inf)] = 0.007 * DEG
    accelerometer_walk: Annotated[float, Range(min=0.0, below=np.inf)] = 2e-4
    gyroscope_walk: Annotated[float, Range(min=0.0, below=np.inf)] = 2e-5
    accelerometer_range: Annotated[float, Range(above=0.0)] = 16.0 * _STANDARD_GRAVITY
    gyroscope_range: Annotated[float, Range(above=0.0)] = 2000.0 * DEG

    def __post_init__(self) -> None:
        check_fields(self)


def read_imu(
    unit: Imu, motion: CapsuleKinematics, bias: Float[np.ndarray, " 6"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], Float[np.ndarray, " 6"]]:
    """Specific force [m/s²] and angular velocity [rad/s] in the capsule frame, and the next bias.

    f = Rᵀ (a + α × r + ω × (ω × r) − g) at the unit's position r (Titterton and Weston 2004, 3.2):
    at rest it reads 1 g upwards.

    Args:
        unit: The unit.
        motion: Motion of the capsule.
        bias: Bias of accelerometer and gyroscope; initially zeros.
        rng: Random number generator of the noise and of the bias's next step, 1/`rate` later.
    """
    rotation = np.asarray(motion.R_world_capsule, float)
    spin, arm = np.array(motion.angular_velocity), rotation @ unit.position_capsule
    swing = np.cross(motion.angular_acceleration, arm) + np.cross(spin, np.cross(spin, arm))
    force = rotation.T @ (np.array(motion.acceleration) + swing - motion.gravity)
    # White noise of density n, sampled at a rate f, has a standard deviation of n √f.
    noise = np.sqrt(unit.rate) * rng.normal(size=6)
    force = force + bias[:3] + unit.accelerometer_noise * noise[:3]
    turn = rotation.T @ spin + bias[3:] + unit.gyroscope_noise * noise[3:]
    walk = np.repeat([unit.accelerometer_walk, unit.gyroscope_walk], 3) / np.sqrt(unit.rate)
    return (
        np.clip(force, -unit.accelerometer_range, unit.accelerometer_range),
        np.clip(turn, -unit.gyroscope_range, unit.gyroscope_range),
        bias + walk * rng.normal(size=6),
    )


@dataclass(frozen=True)
class Magnetometer:
    """Three-axis magnetometer in a capsule.

    The defaults are those of a small unit; a strong magnet nearby saturates it.

    Attributes:
        position_capsule: Position in the capsule [m]; its axes are the capsule's.
        noise: Standard deviation of a reading [T].
        offset: Reading without a field [T], such as that of the capsule's own magnet.
        range: Maximum reading of a component [T]; larger values are clipped.
    """

    position_capsule: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: Annotated[float, Range(min=0.0, below=np.inf)] = 0.5e-6
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    range: Annotated[float, Range(above=0.0)] = 2.5e-3

    def __post_init__(self) -> None:
        check_fields(self)


def read_magnetometer(
    unit: Magnetometer,
    flux_density: Float[np.ndarray, " 3"],
    R_world_capsule: Float[np.ndarray, "3 3"],
    rng: np.random.Generator,
) -> Float[np.ndarray, " 3"]:
    """Reading [T] in the capsule frame of the flux density in the world at the unit's position."""
    reading = np.asarray(R_world_capsule).T @ flux_density + unit.offset
    return np.clip(reading + unit.noise * rng.normal(size=3), -unit.range, unit.range)


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
    gap: Annotated[float, Range(above=-math.inf, below=math.inf, unit="m")] = 50.0 * MM
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

    def __post_init__(self) -> None:
        check_fields(self, of="Sensors")

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
