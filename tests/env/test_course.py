"""Courses of guts: places along them, and which place of them is nearest."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.small_envs import GUT
from tests.support.tubes import bent_tube
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import transform_points
from vrcaps.env.worlds import Course, Memory
from vrcaps.organ.surface import interpolate
from vrcaps.world.model import Model, posture_transform


@pytest.fixture(scope="module")
def course():
    course, device = Course(Memory(2)), read_device("magnetic")
    for index, organ in enumerate((GUT, bent_tube())):
        course.begin(index, Model(organ, device, posture_transform("prone")))
    return course


def test_places_are_those_of_the_centerline(course):
    organ, at = bent_tube(), 0.21234
    points, frames, radius = interpolate(organ.centerline, np.array([at]))
    place, T = course.at(np.array([0.05, at])), posture_transform("prone")
    np.testing.assert_allclose(place.point[1], transform_points(T, points)[0], atol=2e-6)
    np.testing.assert_allclose(place.axes[1], (T[:3, :3] @ frames[0]).T, atol=0.02)
    assert place.radius[1] == pytest.approx(radius[0], abs=1e-5)
    assert place.point[0, 0] == pytest.approx(-0.05)  # prone: the world's x is −x of the patient


def test_nearest_place_is_found_between_samples_and_on_the_right_loop(course):
    numbers, at = np.arange(2), np.array([0.0712, 0.3017])
    here = course.at(at)
    offset = 4e-3 * here.axes[:, 0] - 3e-3 * here.axes[:, 1]
    found = course.nearest(numbers, here.point + offset, at + 0.008, 0.03)
    np.testing.assert_allclose(found, at, atol=2e-4)
    # From one arm of the bend, the arc lengths of the other are out of reach.
    other = course.nearest(numbers[1:], here.point[1:], np.array([0.04]), 0.03)
    assert other[0] <= 0.07 + 2e-3


def test_places_beyond_an_end_are_the_end(course):
    far = course.at(np.array([1.0, -1.0]))
    np.testing.assert_allclose(far.point[0], [-GUT.centerline.length, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(course.at(np.zeros(2)).point[1], far.point[1])
    short = replace(GUT.centerline)
    assert course.nearest(np.array([0]), far.point[:1], np.array([1.0]), 10.0) == short.length
