"""Tracking of a simulated capsule: its sensors are read and fused while the world is stepped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import rotate_by_vector, rotation_vector
from vrcaps.core.rng import stream
from vrcaps.core.units import DEG, MM
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import Source, UniformField, magnet_pose
from vrcaps.sensors.hall import HallArray, perturb_calibration, read_hall
from vrcaps.sensors.pose_filter import PoseBelief, correct, located_magnet, predict
from vrcaps.sensors.sensors import (
    EARTH_FIELD,
    CapsuleKinematics,
    HallPad,
    Imu,
    hall_array,
    read_imu,
)
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device
    from vrcaps.world.world import World

_CALIBRATION_TIME = 1.0
"""Time [s] over which a calibration error is assumed constant: readings within it repeat the error
and do not average it out. The errors change with the fields, as capsule and magnet move."""
_INITIAL_SIGMA = np.repeat([0.0, 0.01, 0.0, 0.02, 1e-3, 1e-4], 3)
"""Standard deviations of the initial state: 1 cm/s, 2 mg, 0.06°/s, and the earth's field."""


@dataclass(frozen=True)
class TrackingSensors:
    """Sensors by which a controller localizes the capsule, read once per control period.

    Attributes:
        imu: IMU in the capsule, assumed to be at its origin; its `rate` is the controller's.
        hall: Hall sensors under the patient.
        earth_field: Magnetic field of the earth in the world [T], which the filter estimates.
        position_error: Standard deviation of each coordinate at the start of tracking [m].
        angle_error: Standard deviation of the rotation about each axis at the start [rad].
    """

    imu: Imu = field(default_factory=Imu)
    hall: HallPad = field(default_factory=HallPad)
    earth_field: tuple[float, float, float] = EARTH_FIELD
    position_error: Annotated[float, Range(above=0.0, max=0.1, unit="m")] = 5.0 * MM
    angle_error: Annotated[float, Range(above=0.0, max=0.5, unit="rad")] = 10.0 * DEG

    def __post_init__(self) -> None:
        check_fields(self)


def check_locatable(device: Device) -> None:
    """Check that a capsule can be localized.

    Raises:
        InputError: If it does not contain exactly one magnet.
    """
    if len(device.magnets) != 1:
        raise InputError(
            f"pose is located, by one magnet in the capsule; {device.name} has "
            f"{len(device.magnets)}. Give a capsule with one in [[magnets]], such as magnetic."
        )


class CapsuleTracker:
    """Estimate of a capsule in a world from its sensors: pose, velocity and force of the wall.

    Provides a controller with the same values as a `World`, but from readings alone: the filter's
    pose and velocity; the wall's force is the specific force less the force of the magnet.

    Attributes:
        size: Size of its state as an array.
        belief: Belief of the filter.
    """

    size: ClassVar[int] = 16 + 4 * 3 + 18 * 18 + 16 + 6 + 6 + 3 * 3 + 2

    def __init__(
        self,
        model: Model,
        settings: TrackingSensors,
        T_world_capsule: Float[np.ndarray, "4 4"],
        *,
        period: float,
        seed: int,
    ) -> None:
        """Start near a pose, with a random offset according to the settings.

        Args:
            model: Organ and device.
            settings: The sensors.
            T_world_capsule: Pose of the capsule.
            period: Time between readings [s].
            seed: Seed of noise and calibration errors, 0 or more.

        Raises:
            InputError: If the device does not contain exactly one magnet.
        """
        check_locatable(model.device)
        (self._magnet,), self._mass = model.device.magnets, model.device.mass
        self._settings, self._seed, self._period = settings, seed, period
        self._array = hall_array(settings.hall, model)
        errors = {"gain": settings.hall.gain_error, "offset": settings.hall.offset_error}
        rng = stream(seed, "tracking/hall-calibration")
        self._true_array = perturb_calibration(self._array, rng, **errors)
        strength = float(np.linalg.norm(settings.earth_field))
        axis = np.array(settings.earth_field if strength > 0.0 else (0.0, 0.0, 1.0))
        self._earth = UniformField(strength, magnet_pose(np.zeros(3), axis))
        sigma = _INITIAL_SIGMA.copy()
        sigma[:3], sigma[6:9] = settings.position_error, settings.angle_error
        none = np.zeros(3)
        start = PoseBelief(T_world_capsule, none, none, none, none, np.diag(sigma**2))
        off = sigma * stream(seed, "tracking/start").normal(size=18)
        off[3:6], off[9:] = 0.0, 0.0
        self.belief = start.moved(off)
        # True pose, velocities and time of the previous reading, IMU bias, number of readings.
        self._last_pose, self._last_velocity = T_world_capsule, np.zeros((2, 3))
        self._bias, self._force_world, self._turn_world = np.zeros(6), np.zeros(3), np.zeros(3)
        self._magnetic_force, self._sources = np.zeros(3), SourceSet(())
        self._last_time, self._count = -np.inf, 0

    @property
    def T_world_capsule(self) -> Float[np.ndarray, "4 4"]:
        """Pose estimated by the filter."""
        return self.belief.T_world_capsule

    @property
    def velocity_world(self) -> Float[np.ndarray, "2 3"]:
        """Velocity of the origin [m/s], and angular velocity [rad/s] from the gyroscope."""
        return np.array([self.belief.velocity_world, self._turn_world])

    @property
    def contact_force_world(self) -> Float[np.ndarray, " 3"]:
        """Lateral force of the wall [N]: mass times specific force, less the magnet's force.

        The component along the capsule's axis, friction or another pull, is excluded.
        """
        force = self._mass * self._force_world - self._magnetic_force
        axis = self.T_world_capsule[:3, 2]
        return force - axis * float(axis @ force)

    def field_angle(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> float:
        """Angle between the moment of a capsule at a pose and the magnet's field there [rad]."""
        source, _ = located_magnet(T_world_capsule, self._magnet)
        flux = self._sources.field(source.T_world_magnet[None, :3, 3])[0][0]
        cosine = flux @ source.T_world_magnet[:3, 2] / max(float(np.linalg.norm(flux)), 1e-12)
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def read(self, world: World, sources: Sequence[Source]) -> None:
        """Read the sensors once and fuse the readings; no effect if repeated at the same time.

        Args:
            world: The current world.
            sources: External magnets at their current poses, as known to the controller.
        """
        if world.time == self._last_time:
            return
        self._sources = SourceSet(sources)
        if self._count:
            self._read_imu(world, world.time - self._last_time)
        self._last_pose, self._last_velocity = world.T_world_capsule, world.velocity_world
        self._read_hall(world.T_world_capsule, sources)
        self._magnetic_force, _ = self._sources.wrench((self._magnet,), self.T_world_capsule)
        self._last_time, self._count = world.time, self._count + 1

    def to_array(self) -> Float[np.ndarray, " q"]:
        """State of the tracker as an array, for `restore`."""
        return np.concatenate([np.ravel(part) for part in self._parts()])

    def restore(self, saved: Float[np.ndarray, " q"], sources: Sequence[Source]) -> None:
        """Restore the state of `to_array`, with the magnets at their poses then."""
        parts = self._parts()
        ends = np.cumsum([part.size for part in parts])
        pieces = [
            piece.reshape(part.shape).copy()
            for piece, part in zip(np.split(saved, ends[:-1]), parts, strict=True)
        ]
        self.belief = PoseBelief(*pieces[:6])
        self._last_pose, self._last_velocity, self._bias = pieces[6:9]
        self._force_world, self._turn_world, self._magnetic_force = pieces[9:12]
        self._last_time, self._count = float(pieces[12][0]), int(pieces[12][1])
        self._sources = SourceSet(sources)

    def _parts(self) -> list[np.ndarray]:
        return [
            *vars(self.belief).values(),
            self._last_pose,
            self._last_velocity,
            self._bias,
            self._force_world,
            self._turn_world,
            self._magnetic_force,
            np.array([self._last_time, self._count]),
        ]

    def _read_imu(self, world: World, dt: float) -> None:
        """Predict from the IMU's reading: means over the time since the last reading."""
        before, after = self._last_pose[:3, :3], world.T_world_capsule[:3, :3]
        turned = rotation_vector(before, after)
        (v0, w0), (v1, w1) = self._last_velocity, world.velocity_world
        motion = CapsuleKinematics(
            rotate_by_vector(0.5 * turned, before),
            acceleration=tuple((v1 - v0) / dt),
            angular_velocity=tuple(turned / dt),
            angular_acceleration=tuple((w1 - w0) / dt),
        )
        unit = replace(self._settings.imu, rate=1.0 / dt)
        rng = stream(self._seed, "tracking/imu", self._count)
        force, turn, self._bias = read_imu(unit, motion, self._bias, rng)
        self.belief = predict(self.belief, unit, force, turn, dt)
        rotation = self.belief.T_world_capsule[:3, :3]
        self._force_world = rotation @ (force - self.belief.accelerometer_bias)
        self._turn_world = rotation @ (turn - self.belief.gyroscope_bias)

    def _read_hall(
        self, T_world_capsule: Float[np.ndarray, "4 4"], sources: Sequence[Source]
    ) -> None:
        """Correct by the readings of the Hall sensors."""
        rng = stream(self._seed, "tracking/hall", self._count)
        inside, _ = located_magnet(T_world_capsule, self._magnet)
        readings = read_hall(self._true_array, [inside, *sources, self._earth], rng)
        sigma = self._hall_sigma(self._array, readings)
        known = self._sources.field(self._array.positions_world)[0]
        self.belief = correct(
            self.belief, self._array.positions_world, readings - known, sigma, self._magnet
        )

    def _hall_sigma(
        self, array: HallArray, readings: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Standard deviation of each reading [T], as if calibration errors were independent."""
        pad = self._settings.hall
        lasting = (pad.gain_error * readings) ** 2 + pad.offset_error**2
        repeats = max(1.0, _CALIBRATION_TIME / self._period)
        return np.sqrt(array.noise**2 + array.resolution**2 / 12.0 + repeats * lasting)
