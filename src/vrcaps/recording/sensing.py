"""Sensor readings in the capsule and under the patient, as columns of `frames.parquet`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotate_vectors, transform_points
from vrcaps.core.rng import stream
from vrcaps.magnet.field import field as flux_density
from vrcaps.magnet.sources import Dipole, Source, UniformField, magnet_pose
from vrcaps.sensors.hall import localize, perturb_calibration, read_hall
from vrcaps.sensors.sensors import (
    CapsuleKinematics,
    HallPad,
    Sensors,
    hall_array,
    read_imu,
    read_magnetometer,
)

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.motion.motion import Step
    from vrcaps.recording.table import FrameTable
    from vrcaps.scenario.build import ResolvedScenario
    from vrcaps.world.model import Model

_LOCALIZED = ("localized_{}_m", "localized_axis_{}")
_CERTAINTY = ("localized_sigma_m", "localized_residual_t")


def pad_column_names(sensors: Sensors) -> tuple[str, ...]:
    """Columns of Hall sensors and of the localized position; NaN where there is no value."""
    if sensors.hall is None:
        return ()
    return (
        *(f"hall_{k}_{axis}_t" for k in range(sensors.hall.count**2) for axis in "xyz"),
        *(name.format(axis) for name in _LOCALIZED for axis in "xyz"),
        *_CERTAINTY,
    )


class SensorReadings:
    """Sensor readings of a recording's frames, in order."""

    def __init__(
        self, model: Model, resolved: ResolvedScenario, before: FrameTable | None = None
    ) -> None:
        """Start a recording, or continue after the rows of an earlier one.

        Args:
            model: Recorded model.
            resolved: Recorded scenario.
            before: Rows of the previous frames, with the last localized position.

        Raises:
            InputError: If the pad has no single magnet to localize, or is invalid.
        """
        self._model, self._seed = model, resolved.scenario.seed
        self._sensors = resolved.scenario.sensors
        earth = np.array(self._sensors.earth_field, float)
        strength = float(np.linalg.norm(earth))
        axis = earth if strength > 0.0 else np.array([0.0, 0.0, 1.0])
        self._earth = UniformField(strength, magnet_pose(np.zeros(3), axis))
        self._imu = None
        if self._sensors.imu is not None:
            self._imu = replace(self._sensors.imu, rate=resolved.fps)
        self._bias = np.zeros(6)
        self._last: np.ndarray | None = None
        if self._sensors.hall is not None:
            self._prepare_pad(self._sensors.hall)
        if before is not None:
            self._continue_from(before)

    def read(self, step: Step, sources: Sequence[Source] = ()) -> dict[str, float]:
        """Return the columns of a frame; call it for each frame in turn.

        Args:
            step: Current frame.
            sources: External magnetic field sources besides the earth.
        """
        columns: dict[str, float] = {}
        pose = step.state.T_world_capsule
        outside = [self._earth, *sources]
        if self._imu is not None:
            rng = self._imu_rng(step.index)
            motion = _motion(step)
            force, turn, self._bias = read_imu(self._imu, motion, self._bias, rng)
            columns |= _named("accelerometer_{}_m_per_s2", force)
            columns |= _named("gyroscope_{}_rad_per_s", turn)
        unit = self._sensors.magnetometer
        if unit is not None:
            position = transform_points(pose, np.array([unit.position_capsule]))
            flux = flux_density(outside, position)[0][0]
            rng = stream(self._seed, "sensors/magnetometer", step.index)
            columns |= _named("magnetometer_{}_t", read_magnetometer(unit, flux, pose[:3, :3], rng))
        if self._sensors.hall is not None:
            columns |= self._read_pad(step, outside)
        return columns

    def _prepare_pad(self, pad: HallPad) -> None:
        magnets, name = self._model.device.magnets, self._model.device.name
        if len(magnets) != 1:
            raise InputError(
                f"Hall sensors find a capsule by one magnet; {name} has {len(magnets)}. Give a "
                "capsule with one in [[magnets]], such as magnetic, or no sensor 'hall'."
            )
        self._array = hall_array(pad, self._model)
        rng = stream(self._seed, "sensors/hall-calibration")
        errors = {"gain": pad.gain_error, "offset": pad.offset_error}
        self._true_array = perturb_calibration(self._array, rng, **errors)

    def _read_pad(self, step: Step, outside: list[Source]) -> dict[str, float]:
        """Sensor readings, and the estimated position and direction of the capsule's magnet."""
        (magnet,) = self._model.device.magnets
        pose = step.state.T_world_capsule
        (position,) = transform_points(pose, np.array([magnet.position_capsule]))
        axis = rotate_vectors(pose, np.array(magnet.moment_capsule))
        inside = Dipole(float(np.linalg.norm(axis)), magnet_pose(position, axis))
        rng = stream(self._seed, "sensors/hall", step.index)
        readings = read_hall(self._true_array, [inside, *outside], rng)
        columns = {
            f"hall_{k}_{name}_t": float(value)
            for k, row in enumerate(readings)
            for name, value in zip("xyz", row, strict=True)
        }
        T_world_magnet = np.full((4, 4), np.nan)
        sigma, residual = math.nan, math.nan
        try:
            # The pose of the steering magnet is known from the arm; the earth's field is not.
            estimate = localize(self._array, readings, inside, known=outside[1:], start=self._last)
        except InputError:  # too few sensors within their range
            self._last = None
        else:
            T_world_magnet, residual = estimate.T_world_magnet, estimate.residual
            sigma = math.sqrt(np.trace(estimate.covariance[:3, :3]))
            # A resumed recording builds it from the table's columns.
            self._last = magnet_pose(T_world_magnet[:3, 3], T_world_magnet[:3, 2])
        for name, column in zip(_LOCALIZED, (3, 2), strict=True):
            columns |= _named(name, T_world_magnet[:3, column])
        return columns | dict(zip(_CERTAINTY, (sigma, residual), strict=True))

    def _continue_from(self, before: FrameTable) -> None:
        """Restore the bias and the last position after the rows of earlier frames."""
        if self._imu is not None:
            still = CapsuleKinematics(np.eye(3))
            for frame in range(len(before)):
                rng = self._imu_rng(frame)
                *_, self._bias = read_imu(self._imu, still, self._bias, rng)
        if self._sensors.hall is not None and len(before):
            position, axis = (
                np.array([float(before.columns[name.format(a)][-1]) for a in "xyz"])
                for name in _LOCALIZED
            )
            self._last = magnet_pose(position, axis) if np.isfinite(position).all() else None

    def _imu_rng(self, frame: int) -> np.random.Generator:
        return stream(self._seed, "sensors/imu", frame)


def _motion(step: Step) -> CapsuleKinematics:
    """Kinematics of the capsule at a frame; accelerations from the neighboring velocities."""
    state = step.state
    before, after = step.previous or state, step.next or state
    time = after.time - before.time

    def rate(name: str) -> tuple[float, float, float]:
        change = np.asarray(getattr(after, name)) - np.asarray(getattr(before, name))
        return _triple(change / time if time > 0.0 else np.zeros(3))

    return CapsuleKinematics(
        state.T_world_capsule[:3, :3],
        acceleration=rate("linear_velocity_world"),
        angular_velocity=_triple(state.angular_velocity_world),
        angular_acceleration=rate("angular_velocity_world"),
    )


def _triple(vector: Float[np.ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = np.asarray(vector, float).tolist()
    return x, y, z


def _named(name: str, values: Sequence[float] | np.ndarray) -> dict[str, float]:
    return {name.format(axis): float(x) for axis, x in zip("xyz", values, strict=True)}
