"""Ways past a ball."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.actuation.vectors import detour


def test_a_free_way_is_gone_straight():
    start, end = np.array([2.0, -3.0, 0.0]), np.array([2.0, 3.0, 0.0])
    np.testing.assert_array_equal(detour(start, end, np.zeros(3), 1.9), end)


def test_a_blocked_way_goes_along_the_tangent():
    """From 2 radii away its angle to the line to the center is 30°."""
    start, end = np.array([-2.0, 0.0, 0.0]), np.array([5.0, 0.1, 0.0])
    way = detour(start, end, np.zeros(3), 1.0) - start
    np.testing.assert_allclose(
        way / np.linalg.norm(way), [np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0], atol=1e-12
    )
    assert np.linalg.norm(way) > np.sqrt(3.0)  # beyond where it touches


def test_an_end_in_the_ball_is_moved_out():
    near, far = np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 5.0])
    np.testing.assert_allclose(detour(far, near, np.zeros(3), 2.0), [0, 0, 2], atol=1e-12)
    np.testing.assert_array_equal(detour(near, far, np.zeros(3), 2.0), far)


@pytest.mark.slow
@pytest.mark.parametrize("through", [False, True])
def test_small_steps_end_where_they_should_and_stay_out_of_the_ball(through):
    """From any place outside to any other, also one right behind it."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        center, start = rng.normal(size=(2, 3))
        start = center + 1.5 * (start - center) / np.linalg.norm(start - center)
        end = center + rng.normal(size=3)
        end = center + 1.2 * (end - center) / np.linalg.norm(end - center)
        if through:
            end = center - 0.9 * (start - center)
        place = start
        for _ in range(1000):
            way = detour(place, end, center, 1.0) - place
            place = place + way * min(1.0, 0.01 / max(np.linalg.norm(way), 1e-12))
            assert np.linalg.norm(place - center) > 1.0 - 1e-6
        np.testing.assert_allclose(place, end, atol=1e-9)
