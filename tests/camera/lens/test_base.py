"""The arithmetic that lens models share, against closed forms."""

import math

import numpy as np
import pytest

from vrcaps.camera.lens.base import (
    angles_to_axis,
    first_positive_root,
    invert_monotone,
    rays_at_angles,
)


@pytest.mark.parametrize(
    ("coefficients", "root"),
    [
        ((1.0,), math.inf),
        ((1.0, 0.0, 0.0), math.inf),
        ((1.0, 1.0), math.inf),
        ((1.0, -0.25), 4.0),
        ((6.0, -5.0, 1.0), 2.0),
        ((1.0, 0.0, 1.0), math.inf),
        ((-6.0, 1.0, 1.0), 2.0),
    ],
)
def test_first_positive_root(coefficients, root):
    assert first_positive_root(coefficients) == pytest.approx(root, rel=1e-12)


def test_inverse_of_the_sine_up_to_its_flat_top():
    x = np.linspace(0.0, math.pi / 2, 1001)
    found = invert_monotone(np.sin, np.cos, np.sin(x), math.pi / 2)
    np.testing.assert_allclose(found[:-50], x[:-50], atol=1e-14)
    np.testing.assert_allclose(np.sin(found), np.sin(x), atol=2e-16)


def test_inverse_of_a_steep_power_keeps_its_relative_accuracy():
    x = np.geomspace(1e-3, 1.0, 500)
    found = invert_monotone(lambda x: x**3, lambda x: 3.0 * x**2, x**3, 1.0)
    np.testing.assert_allclose(found, x, rtol=1e-9)


def test_inverse_clips_to_the_interval_and_keeps_nan():
    values = np.array([-1.0, 0.0, 2.0, 9.0, np.nan])
    found = invert_monotone(lambda x: 2.0 * x, lambda x: 0.0 * x + 2.0, values, 3.0)
    np.testing.assert_array_equal(found, [0.0, 0.0, 1.0, 3.0, np.nan])


def test_rays_stand_at_their_angle_to_the_axis():
    rng = np.random.default_rng(0)
    angle, direction = rng.uniform(0.0, math.pi, 500), rng.normal(size=(500, 2))
    rays = rays_at_angles(angle, direction)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(angles_to_axis(rays), angle, atol=1e-14)
    np.testing.assert_allclose(
        rays[:, 0] * direction[:, 1], rays[:, 1] * direction[:, 0], atol=1e-13
    )
