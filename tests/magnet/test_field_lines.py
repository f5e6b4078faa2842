"""Field lines against the closed form of a dipole's, and the symmetry of a cylinder's."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, transform_points
from vrcaps.core.units import MM
from vrcaps.magnet.field import field_lines, magnet_lines
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Cylinder, Dipole, magnet_pose


def test_a_dipole_has_lines_r_equals_r0_sin_squared_theta():
    """In a plane through the moment, whatever the pose (Jackson 1999, section 5.6)."""
    pose = magnet_pose((0.1, -0.2, 0.3), (1.0, 2.0, -0.5))
    theta, r0 = 0.5, np.array([0.1, 0.2, 0.4])
    r = r0 * np.sin(theta) ** 2
    starts = np.stack([r * np.sin(theta), 0.0 * r, r * np.cos(theta)], axis=1)

    def is_north(points: np.ndarray) -> np.ndarray:
        return transform_points(invert(pose), points)[:, 2] > -0.02

    dipole = Dipole(400.0, pose)
    lines = field_lines([dipole], transform_points(pose, starts), step=1.0 * MM, goes_on=is_north)
    for line, expected in zip(lines, r0, strict=True):
        points = transform_points(invert(pose), line)
        size = np.linalg.norm(points, axis=1)
        sine = np.hypot(points[:, 0], points[:, 1]) / size
        assert points[-1, 2] < -0.02 < points[-2, 2]
        np.testing.assert_allclose(size / sine**2, expected, rtol=2e-6)
        np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-9)


def test_lines_of_a_magnet_come_back_to_its_other_face_where_they_left():
    """B(ρ, −z) is B(ρ, z) with its radial part reversed, so a line mirrors itself."""
    magnet = read_magnet("cylinder-76.2")
    step, rings = 2.0 * MM, 4
    lines = magnet_lines(magnet, reach=0.6, step=step, rings=rings, meridians=3)
    assert len(lines) == 3 * rings
    closed = [line for line in lines if np.linalg.norm(line[-1]) < magnet.length]
    assert len(closed) == 3 * (rings - 1)  # the innermost leads out of reach
    for line in closed:
        start, end = line[0], line[-1]
        assert np.hypot(*end[:2]) == pytest.approx(np.hypot(*start[:2]), abs=step)
        assert -0.5 * magnet.length < end[2] < -0.5 * magnet.length + step
        assert start[0] * end[1] - start[1] * end[0] == pytest.approx(0.0, abs=1e-9)
    far = [line for line in lines if np.linalg.norm(line[-1]) >= 0.6]
    assert all(np.linalg.norm(line[-2]) < 0.6 for line in far)


def test_numbers_out_of_range_are_told():
    start, dipole = np.array([[0.1, 0.0, 0.0]]), Dipole(1.0)

    def always(points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), bool)

    with pytest.raises(InputError, match=r"step is 0.0. Allowed: above 0 m"):
        field_lines([dipole], start, step=0.0, goes_on=always)
    with pytest.raises(InputError, match=r"most is 0. Allowed: 1 to 100000"):
        field_lines([dipole], start, step=0.1, goes_on=always, most=0)
    magnet = Cylinder(0.05, 0.05, 1.4)
    with pytest.raises(InputError, match=r"rings is 0. Allowed: 1 to 100"):
        magnet_lines(magnet, reach=0.5, step=0.01, rings=0)
    with pytest.raises(InputError, match=r"meridians is 0. Allowed: 1 to 100"):
        magnet_lines(magnet, reach=0.5, step=0.01, meridians=0)
