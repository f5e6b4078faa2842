"""Error-state Kalman filter of a capsule's pose, from its IMU and an array of Hall sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import rotate_by_vector, rotation_vector, transform_from
from vrcaps.magnet.sources import Dipole, InternalMagnet, magnet_pose
from vrcaps.sensors.hall import magnet_readings
from vrcaps.sensors.sensors import Imu
from vrcaps.world.control import GRAVITY

if TYPE_CHECKING:
    from jaxtyping import Float

_SIZE = 18
_P, _V, _R, _A, _G, _B = (slice(k, k + 3) for k in range(0, _SIZE, 3))
_SEEN = np.r_[_P, _R, _B]
"""Parts of the state that a Hall sensor reading depends on."""
_BACKGROUND_WALK = 1e-8
"""Random walk of the background field [T/√s]: the earth's field is nearly constant."""
_MAX_ITERATIONS = 5
_CONVERGED = np.repeat([1e-5, 1e-4, 1e-8], 3)
"""Step [m, rad, T] below which a correction is not relinearized."""


@dataclass(frozen=True)
class PoseBelief:
    """Mean and covariance of the filter's state.

    Attributes:
        T_world_capsule: Pose of the capsule.
        velocity_world: Velocity of its origin [m/s].
        accelerometer_bias: Bias of the accelerometer [m/s²].
        gyroscope_bias: Bias of the gyroscope [rad/s].
        background: Uniform background field [T].
        covariance: Covariance of the errors of position [m], velocity [m/s], rotation about the
            world's axes [rad], both biases and background, in this order.
    """

    T_world_capsule: Float[np.ndarray, "4 4"]
    velocity_world: Float[np.ndarray, " 3"]
    accelerometer_bias: Float[np.ndarray, " 3"]
    gyroscope_bias: Float[np.ndarray, " 3"]
    background: Float[np.ndarray, " 3"]
    covariance: Float[np.ndarray, "18 18"]

    @property
    def position_sigma(self) -> float:
        """Standard deviation of the position [m]."""
        return float(np.sqrt(np.trace(self.covariance[_P, _P])))

    @property
    def roll_sigma(self) -> float:
        """Standard deviation of the rotation about the capsule's axis [rad]."""
        axis = self.T_world_capsule[:3, 2]
        return float(np.sqrt(axis @ self.covariance[_R, _R] @ axis))

    def moved(self, error: Float[np.ndarray, " 18"]) -> PoseBelief:
        """Return the belief with an error added to its mean."""
        T = self.T_world_capsule
        pose = transform_from(rotate_by_vector(error[_R], T[:3, :3]), T[:3, 3] + error[_P])
        return PoseBelief(
            pose,
            self.velocity_world + error[_V],
            self.accelerometer_bias + error[_A],
            self.gyroscope_bias + error[_G],
            self.background + error[_B],
            self.covariance,
        )

    def error_from(self, other: PoseBelief) -> Float[np.ndarray, " 18"]:
        """Error from another belief's mean to this one: ``other.moved(error)``."""
        pose, start = self.T_world_capsule, other.T_world_capsule
        return np.concatenate(
            [
                pose[:3, 3] - start[:3, 3],
                self.velocity_world - other.velocity_world,
                rotation_vector(start[:3, :3], pose[:3, :3]),
                self.accelerometer_bias - other.accelerometer_bias,
                self.gyroscope_bias - other.gyroscope_bias,
                self.background - other.background,
            ]
        )


def predict(
    belief: PoseBelief,
    unit: Imu,
    force: Float[np.ndarray, " 3"],
    turn: Float[np.ndarray, " 3"],
    dt: float,
) -> PoseBelief:
    """Belief after a time `dt`, from the IMU's reading (Solà 2017, section 7: global errors).

    Args:
        belief: Belief before.
        unit: The IMU, at the capsule's origin; its noise is that of a reading's mean over `dt`.
        force: Measured specific force [m/s²].
        turn: Measured angular velocity [rad/s].
        dt: Duration [s].
    """
    T = belief.T_world_capsule
    turned = T[:3, :3] @ (turn - belief.gyroscope_bias) * dt
    middle = rotate_by_vector(0.5 * turned, T[:3, :3])
    force_world = middle @ (force - belief.accelerometer_bias)
    acceleration = force_world - [0.0, 0.0, GRAVITY]
    velocity = belief.velocity_world + acceleration * dt
    position = T[:3, 3] + 0.5 * (belief.velocity_world + velocity) * dt
    pose = transform_from(rotate_by_vector(turned, T[:3, :3]), position)
    step = np.eye(_SIZE)
    step[_V, _R], step[_V, _A] = -dt * _cross(force_world), -dt * middle
    step[_R, _G] = -dt * middle
    step[_P] += 0.5 * dt * (step[_V] + np.eye(_SIZE)[_V])
    walks = (
        0.0,
        unit.accelerometer_noise,
        unit.gyroscope_noise,
        unit.accelerometer_walk,
        unit.gyroscope_walk,
        _BACKGROUND_WALK,
    )
    noise = np.diag(dt * np.repeat(walks, 3) ** 2)
    noise[_V, _V] += _clipping(force, unit.accelerometer_range, middle, dt)
    noise[_R, _R] += _clipping(turn, unit.gyroscope_range, middle, dt)
    covariance = step @ belief.covariance @ step.T + noise
    return replace(belief, T_world_capsule=pose, velocity_world=velocity, covariance=covariance)


def _clipping(
    reading: Float[np.ndarray, " 3"],
    largest: float,
    R_world_capsule: Float[np.ndarray, "3 3"],
    dt: float,
) -> Float[np.ndarray, "3 3"]:
    """Covariance of the part of a reading lost by clipping, over `dt`.

    A capsule that flips in the field, or hits a wall, exceeds the range by an unknown amount,
    assumed to equal the range.
    """
    lost = np.where(np.abs(reading) >= largest, largest * dt, 0.0)
    return (R_world_capsule * lost**2) @ R_world_capsule.T


def correct(
    belief: PoseBelief,
    positions: Float[np.ndarray, "n 3"],
    readings: Float[np.ndarray, "n 3"],
    sigma: Float[np.ndarray, "n 3"],
    magnet: InternalMagnet,
) -> PoseBelief:
    """Belief after readings of Hall sensors: iterated Kalman update (Bell and Cathey 1993).

    Args:
        belief: Belief before.
        positions: Positions of the sensors in the world [m].
        readings: Flux density without that of known sources [T]; NaN is ignored.
        sigma: Standard deviation of each reading [T].
        magnet: The capsule's magnet.
    """
    used = np.isfinite(readings).ravel()
    weight = 1.0 / sigma.ravel()[used]
    estimate, covariance = belief, belief.covariance
    for _ in range(_MAX_ITERATIONS):
        rest, rows = _innovation(estimate, positions, readings, magnet)
        rest, rows = weight * rest[used], weight[:, None] * rows[used]
        back = estimate.error_from(belief)
        information = rows.T @ rows
        prior = belief.covariance[_SEEN]
        gain = np.linalg.solve(np.eye(9) + information @ prior[:, _SEEN], np.eye(9))
        # (P⁻¹ + HᵀH)⁻¹ Hᵀ r, without inverting the covariance of the whole state.
        error = prior.T @ (gain @ (rows.T @ (rest + rows @ back[_SEEN])))
        covariance = belief.covariance - prior.T @ (gain @ information) @ prior
        estimate = belief.moved(error)
        if (np.abs(error - back)[_SEEN] < _CONVERGED).all():
            break
    return replace(estimate, covariance=0.5 * (covariance + covariance.T))


def _innovation(
    belief: PoseBelief,
    positions: Float[np.ndarray, "n 3"],
    readings: Float[np.ndarray, "n 3"],
    magnet: InternalMagnet,
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m 9"]]:
    """Innovation of readings [T], and the Jacobian of predicted readings by their states."""
    source, arm = located_magnet(belief.T_world_capsule, magnet)
    flux, by_place, by_turn = magnet_readings(positions, source)
    # Rotation about the capsule's origin also moves the magnet, by δθ × arm.
    by_turn = by_turn - by_place @ _cross(arm)
    even = np.broadcast_to(np.eye(3), by_place.shape)
    rows = np.concatenate([by_place, by_turn, even], axis=-1)
    return (readings - flux - belief.background).ravel(), rows.reshape(-1, 9)


def located_magnet(
    T_world_capsule: Float[np.ndarray, "4 4"], magnet: InternalMagnet
) -> tuple[Dipole, Float[np.ndarray, " 3"]]:
    """A capsule's magnet in the world, and its offset from the capsule's origin there [m]."""
    rotation = T_world_capsule[:3, :3]
    arm, moment = rotation @ magnet.position_capsule, rotation @ magnet.moment_capsule
    pose = magnet_pose(T_world_capsule[:3, 3] + arm, moment)
    return Dipole(float(np.linalg.norm(moment)), pose), arm


def _cross(v: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Matrix of the cross product with v."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
