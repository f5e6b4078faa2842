"""Localization: exact without noise, as good as its covariance says with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Cylinder, Dipole, UniformField, magnet_pose
from vrcaps.sensors.hall import hall_grid, localize, read_hall

ARRAY = hall_grid(0.35, 6)
PERFECT = replace(ARRAY, noise=0.0, resolution=0.0)
EARTH = UniformField(50e-6, magnet_pose((0, 0, 0), (1, 2, -3)))
WIDE = Cylinder(0.02, 0.004, 1.3)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return magnet_pose(rng.uniform((-0.1, -0.1, 0.06), (0.1, 0.1, 0.18)), rng.normal(size=3))


@pytest.mark.slow
@pytest.mark.parametrize("magnet", [Dipole(0.5), WIDE, read_magnet("capsule-11x10")])
def test_without_noise_the_pose_is_found_exactly(magnet):
    rng = np.random.default_rng(0)
    for _ in range(5):
        pose = random_pose(rng)
        reading = read_hall(PERFECT, [replace(magnet, T_world_magnet=pose), EARTH], rng)
        estimate = localize(PERFECT, reading, magnet)
        np.testing.assert_allclose(estimate.T_world_magnet[:3, 3], pose[:3, 3], atol=1e-8)
        np.testing.assert_allclose(estimate.T_world_magnet[:3, 2], pose[:3, 2], atol=1e-7)
        expected = 50e-6 * EARTH.T_world_magnet[:3, 2]
        np.testing.assert_allclose(estimate.background, expected, atol=1e-11)
        assert estimate.residual < 1e-11


@pytest.mark.slow
def test_covariance_is_that_of_the_errors():
    """Normalized errors have the size 1 (chi-square of 3, 30 fixes, 4 σ)."""
    rng = np.random.default_rng(1)
    magnet = read_magnet("capsule-11x10")
    chi = []
    for _ in range(30):
        pose = random_pose(rng)
        estimate = localize(
            ARRAY, read_hall(ARRAY, [replace(magnet, T_world_magnet=pose)], rng), magnet
        )
        miss = estimate.T_world_magnet[:3, 3] - pose[:3, 3]
        chi.append(miss @ np.linalg.solve(estimate.covariance[:3, :3], miss))
        np.testing.assert_allclose(estimate.residual, ARRAY.noise, rtol=0.5)
    assert abs(np.mean(chi) - 3) < 4 * np.sqrt(6 / 30)


def test_a_known_magnet_is_taken_off_and_lost_sensors_are_left_out():
    """The steering magnet drives the nearest sensors out of range; the rest suffice."""
    rng = np.random.default_rng(2)
    array = replace(ARRAY, range=5e-3)
    steering = read_magnet("cylinder-101.6", magnet_pose((0.1, 0.1, 0.5), (0, 1, -1)))
    magnet, pose = read_magnet("capsule-11x10"), magnet_pose((-0.03, 0.02, 0.08), (0, 1, 1))
    reading = read_hall(array, [steering, replace(magnet, T_world_magnet=pose)], rng)
    reading[:5] = np.nan
    estimate = localize(array, reading, magnet, known=[steering])
    assert np.linalg.norm(estimate.T_world_magnet[:3, 3] - pose[:3, 3]) < 2e-3


def test_a_start_near_by_comes_to_the_same():
    rng = np.random.default_rng(3)
    magnet, pose = read_magnet("capsule-11x10"), random_pose(rng)
    reading = read_hall(ARRAY, [replace(magnet, T_world_magnet=pose)], rng)
    near = magnet_pose(pose[:3, 3] + 0.01, pose[:3, 2] + 0.2)
    one, other = localize(ARRAY, reading, magnet), localize(ARRAY, reading, magnet, start=near)
    np.testing.assert_allclose(one.T_world_magnet[:3, 3], other.T_world_magnet[:3, 3], atol=1e-7)
    np.testing.assert_allclose(one.T_world_magnet[:3, 2], other.T_world_magnet[:3, 2], atol=1e-6)


def test_too_few_readings():
    reading = np.full(ARRAY.positions_world.shape, np.nan)
    reading[:2] = 0.0
    with pytest.raises(InputError, match=r"6 finite readings\. Allowed: 8 or more"):
        localize(ARRAY, reading, Dipole(1.0))
    with pytest.raises(InputError, match=r"Readings have shape \(3,\)\. Allowed: \(36, 3\)"):
        localize(ARRAY, np.zeros(3), Dipole(1.0))
