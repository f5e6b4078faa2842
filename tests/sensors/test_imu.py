"""Readings of an IMU and a magnetometer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.scenes import random_poses
from vrcaps.core.errors import InputError
from vrcaps.sensors.sensors import (
    CapsuleKinematics,
    Imu,
    Magnetometer,
    read_imu,
    read_magnetometer,
)

QUIET = Imu(
    accelerometer_noise=0.0, gyroscope_noise=0.0, accelerometer_walk=0.0, gyroscope_walk=0.0
)
RNG = np.random.default_rng(0)
NONE = np.zeros(6)


def test_at_rest_it_reads_one_g_upwards():
    rotation = random_poses(RNG, 1)[0, :3, :3]
    force, turn, bias = read_imu(QUIET, CapsuleKinematics(rotation), NONE, RNG)
    np.testing.assert_allclose(force, rotation.T @ [0, 0, 9.80665])
    assert not turn.any()
    assert not bias.any()


def test_falling_it_reads_nothing():
    motion = CapsuleKinematics(np.eye(3), acceleration=(0.0, 0.0, -9.80665))
    assert not read_imu(QUIET, motion, NONE, RNG)[0].any()


def test_off_center_it_feels_the_turning():
    """The second derivative of its place, by differences: R(t) r with changing spin."""
    from scipy.spatial.transform import Rotation

    unit = replace(QUIET, position_capsule=(0.003, -0.002, 0.009))
    start = random_poses(RNG, 1)[0, :3, :3]
    spin, change, h = np.array([3.0, -2.0, 5.0]), np.array([40.0, 10.0, -20.0]), 1e-4

    def place(t: float) -> np.ndarray:
        """Third order in t: ω t + α t²/2 as one turn."""
        turn = Rotation.from_rotvec(spin * t + change * t**2 / 2).as_matrix()
        return turn @ start @ unit.position_capsule

    acceleration = (place(h) - 2 * place(0.0) + place(-h)) / h**2
    motion = CapsuleKinematics(start, (0, 0, 0), tuple(spin), tuple(change), (0.0, 0.0, 0.0))
    force, turn, _ = read_imu(unit, motion, NONE, RNG)
    np.testing.assert_allclose(start @ force, acceleration, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(turn, start.T @ spin)


def test_noise_and_walk_have_their_densities():
    """σ = n √f; a bias that walks for a time t has σ = w √t."""
    unit, rng = Imu(rate=400.0), np.random.default_rng(1)
    readings, ends = [], []
    for _ in range(60):
        bias = np.zeros(6)
        for _ in range(50):
            force, turn, following = read_imu(unit, CapsuleKinematics(np.eye(3)), bias, rng)
            readings.append(np.concatenate([force - [0, 0, 9.80665], turn]) - bias)
            bias = following
        ends.append(bias)
    density = np.repeat([unit.accelerometer_noise, unit.gyroscope_noise], 3)
    np.testing.assert_allclose(np.std(readings, axis=0), density * 20, rtol=0.1)
    walk = np.repeat([unit.accelerometer_walk, unit.gyroscope_walk], 3) * np.sqrt(50 / 400)
    np.testing.assert_allclose(
        np.sqrt(np.mean(np.square(ends))), np.sqrt(np.mean(walk**2)), rtol=0.3
    )


def test_readings_end_at_the_range():
    motion = CapsuleKinematics(np.eye(3), (0, 0, 1e4), (0, -1e3, 0))
    force, turn, _ = read_imu(QUIET, motion, NONE, RNG)
    assert force[2] == QUIET.accelerometer_range
    assert turn[1] == -QUIET.gyroscope_range


def test_magnetometer_reads_the_field_in_its_frame():
    rotation = random_poses(RNG, 1)[0, :3, :3]
    unit = Magnetometer(noise=0.0, offset=(1e-6, 0, 0))
    reading = read_magnetometer(unit, np.array([0, 0, 5e-5]), rotation, RNG)
    np.testing.assert_allclose(reading, 5e-5 * rotation[2] + [1e-6, 0, 0], atol=1e-20)
    near = read_magnetometer(unit, np.array([0.2, 0, 0]), np.eye(3), RNG)
    assert near[0] == unit.range
    noisy = [read_magnetometer(Magnetometer(), np.zeros(3), rotation, RNG) for _ in range(3000)]
    np.testing.assert_allclose(np.std(noisy, axis=0), 0.5e-6, rtol=0.1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Imu(rate=0.0), r"^rate is 0\.0\. Allowed: above 0 Hz"),
        (lambda: Imu(gyroscope_noise=-1.0), r"^gyroscope_noise is -1\.0"),
        (
            lambda: Imu(gyroscope_walk=-1.0),
            r"^gyroscope_walk is -1\.0\. Allowed: 0 or",
        ),
        (
            lambda: Imu(accelerometer_range=0.0),
            r"accelerometer_range is 0\.0\. Allowed: above",
        ),
        (lambda: Magnetometer(noise=-1.0), r"^noise is -1\.0\. Allowed: 0 or more"),
        (lambda: Magnetometer(range=0.0), r"^range is 0\.0\. Allowed: above 0"),
    ],
)
def test_impossible_units(make, message):
    with pytest.raises(InputError, match=message):
        make()
