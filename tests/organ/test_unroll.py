"""The unrolled wall: of a cylinder it is an exact map, and a lesion lies at its coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support import tubes
from tests.support.shapes import with_ball
from vrcaps._core import Wall
from vrcaps.organ.surface import Appearance, OrganSurface
from vrcaps.organ.unroll import dissection, instances, unroll

RADIUS, LENGTH = 0.02, 0.2
AROUND, ALONG = 128, 81


@pytest.fixture(scope="module")
def tube() -> OrganSurface:
    """An open cylinder about z, its texture a map of (theta, z)."""
    columns, rows = np.meshgrid(np.arange(64), np.arange(32))
    albedo = np.stack([4 * columns, 8 * (31 - rows), 0 * rows], axis=-1).astype(np.uint8)
    texture = Appearance(albedo, np.zeros((32, 64), np.uint8), np.zeros((32, 64), np.float32))
    return replace(tubes.straight_tube(LENGTH, RADIUS, AROUND, ALONG), appearance=texture)


def grid(width: int = 60, height: int = 40) -> tuple[np.ndarray, np.ndarray]:
    s = LENGTH * (np.arange(width) + 0.5) / width
    return s, np.pi * (1.0 - 2.0 * (np.arange(height) + 0.5) / height)


def test_a_cylinder_is_mapped_exactly(tube: OrganSurface) -> None:
    """The wall met at (s, θ) has these gut coordinates, at a distance within the facets' sag."""
    s, theta = grid()
    rolled = unroll(tube, Wall(tube.vertices, tube.faces), s, theta)
    corners = tube.faces[rolled.face]
    place = np.einsum("hwc,hwcx->hwx", rolled.weights, tube.vertices[corners])
    np.testing.assert_allclose(place[..., 2], np.broadcast_to(s, place.shape[:2]), atol=1e-7)
    angle = np.arctan2(place[..., 1], place[..., 0])
    np.testing.assert_allclose(angle, np.broadcast_to(theta[:, None], angle.shape), atol=1e-5)
    sag = RADIUS * (1.0 - np.cos(np.pi / AROUND))
    assert rolled.radius.max() <= RADIUS * (1.0 + 1e-6)
    assert rolled.radius.min() >= RADIUS - 1.001 * sag


def test_the_texture_lies_as_it_does_on_the_wall(tube: OrganSurface) -> None:
    """Red grows with the angle, green with the arc length; shading keeps their ratio."""
    s, theta = grid(64, 64)
    rolled = unroll(tube, Wall(tube.vertices, tube.faces), s, theta)
    image = dissection(tube, replace(rolled, shade=np.full(rolled.face.shape, 1 / 1.35)))
    red, green = np.meshgrid((theta / np.pi + 1.0) / 2.0, s / LENGTH, indexing="ij")
    assert np.abs(image[..., 0] - red).max() < 0.03
    assert np.abs(image[..., 1] - green).max() < 0.05


def test_shading_of_a_smooth_cylinder_is_even(tube: OrganSurface) -> None:
    s, theta = grid()
    rolled = unroll(tube, Wall(tube.vertices, tube.faces), s, theta)
    assert np.ptp(rolled.shade) < 0.02


@pytest.mark.parametrize(("at", "angle"), [(0.05, 1.0), (0.14, -2.0), (0.1, np.pi)])
def test_a_lesion_lies_at_its_arc_length_and_angle(
    tube: OrganSurface, at: float, angle: float
) -> None:
    size = 0.006
    turn = np.angle(np.exp(1j * (tube.theta - angle)))
    near = np.hypot(tube.arc_length - at, RADIUS * turn) < size
    ill = replace(tube, instance=np.where(near, 7, 0).astype(np.uint16))
    s, theta = grid(200, 120)
    found = instances(ill, unroll(ill, Wall(ill.vertices, ill.faces), s, theta)) == 7
    rows, columns = np.nonzero(found)
    assert s[columns].mean() == pytest.approx(at, abs=1e-3)
    mean = np.angle(np.exp(1j * (theta[rows] - angle)).mean())
    assert mean == pytest.approx(0.0, abs=0.03)
    area = found.sum() * (LENGTH / 200) * (2 * np.pi * RADIUS / 120)
    assert area == pytest.approx(np.pi * size**2, rel=0.15)


def test_a_lesion_on_the_centerline_hides_no_whole_ring(tube: OrganSurface) -> None:
    """A ball about the axis, as a polyp's head may hang there: the wall beside it is seen too."""
    middle = 0.5 * LENGTH
    organ = with_ball(tube, np.array([0.0, 0.0, middle]), 0.5 * RADIUS)
    s, theta = grid()
    rolled = unroll(organ, Wall(organ.vertices, organ.faces), s, theta)
    ring = instances(organ, rolled)[:, np.abs(s - middle) < 0.4 * RADIUS]
    assert ring.shape[1] > 2
    assert (ring == 1).any(axis=0).all()
    assert (ring == 0).any(axis=0).all()


def test_rays_that_leave_are_nothing(tube: OrganSurface) -> None:
    half = replace(
        tube, faces=tube.faces[tube.theta[tube.faces].max(axis=1) < 0.0], appearance=None
    )
    half = replace(half, uv=np.zeros((len(half.faces), 3, 2)))
    s, theta = grid()
    rolled = unroll(half, Wall(half.vertices, half.faces), s, theta)
    above = theta > 0.1
    assert (rolled.face[above] == -1).all()
    assert np.isnan(rolled.radius[above]).all()
    image = dissection(half, rolled)
    assert np.ptp(image[above]) == 0.0
    assert instances(half, rolled)[above].max() == 0
    assert image[theta < -0.2][..., 0].max() < image[above].max()
