"""Readings of a Hall array."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.magnet.field import field
from vrcaps.magnet.sources import Dipole, UniformField, magnet_pose
from vrcaps.sensors.hall import HallArray, hall_grid, perturb_calibration, read_hall

ARRAY = hall_grid(0.3, 4)
RNG = np.random.default_rng(0)
MAGNET = Dipole(1.0, magnet_pose((0.02, 0.01, 0.12), (1, 0, -2)))


def test_a_perfect_array_reads_the_field():
    perfect = replace(ARRAY, noise=0.0, resolution=0.0)
    reading = read_hall(perfect, [MAGNET], np.random.default_rng(0))
    assert np.array_equal(reading, field([MAGNET], ARRAY.positions_world)[0])


def test_noise_gain_and_offset_have_their_sizes():
    rng = np.random.default_rng(1)
    array = replace(ARRAY, noise=2e-6, resolution=0.0, gain=1.1, offset=3e-6)
    readings = np.array([read_hall(array, [UniformField(1e-4)], rng) for _ in range(2000)])
    np.testing.assert_allclose(readings.std(axis=0), 2e-6, rtol=0.1)
    np.testing.assert_allclose(readings.mean(axis=0)[:, 2], 1.1e-4 + 3e-6, rtol=2e-3)
    real = perturb_calibration(hall_grid(0.3, 60), rng, gain=0.02, offset=5e-6)
    np.testing.assert_allclose(np.std(real.gain), 0.02, rtol=0.05)
    np.testing.assert_allclose(np.std(real.offset), 5e-6, rtol=0.05)


def test_readings_are_rounded_and_end_at_the_range():
    array = replace(ARRAY, noise=0.0, resolution=1e-5, range=2e-3)
    reading = read_hall(array, [UniformField(1.234e-4)], np.random.default_rng(2))
    np.testing.assert_allclose(reading[:, 2], 1.2e-4)
    strong = read_hall(array, [UniformField(3e-3)], np.random.default_rng(2))
    assert np.isnan(strong[:, 2]).all()
    assert not strong[:, :2].any()


def test_a_seed_gives_the_same_readings():
    one, other = (read_hall(ARRAY, [MAGNET], np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one, other)


def test_grid_stands_in_its_frame():
    pose = magnet_pose((1, 2, 3), (1, 0, 0))
    placed = hall_grid(0.2, 3, pose).positions_world
    np.testing.assert_allclose(placed[:, 0], 1.0, atol=1e-15)
    np.testing.assert_allclose(placed.mean(axis=0), [1, 2, 3])
    np.testing.assert_allclose(np.ptp(placed, axis=0), [0, 0.2, 0.2], atol=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HallArray(np.zeros(3)), r"Sensors have shape \(3,\)\. Allowed: n rows of 3"),
        (lambda: replace(ARRAY, noise=-1.0), r"HallArray noise is -1\.0\. Allowed: 0 or more"),
        (lambda: replace(ARRAY, resolution=np.nan), r"HallArray resolution is nan"),
        (lambda: replace(ARRAY, range=0.0), r"HallArray range is 0\.0\. Allowed: above 0"),
        (lambda: hall_grid(0.0, 4), r"array's width is 0\.0\. Allowed: above 0"),
        (lambda: hall_grid(0.3, 1), r"count is 1\. Allowed: 2 or more"),
        (
            lambda: perturb_calibration(ARRAY, RNG, gain=-1.0),
            r"error of gain is -1\.0\. Allowed: 0 or more",
        ),
        (lambda: perturb_calibration(ARRAY, RNG, offset=np.nan), r"error of offset is nan"),
    ],
)
def test_impossible_arrays(make, message):
    with pytest.raises(InputError, match=message):
        make()
