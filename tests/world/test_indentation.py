"""Indentation by a capsule, compared with the core's contact and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.walls import HALF_AXIS, LINEAR, LYING, RADIUS, capsule, world_on
from vrcaps import _core
from vrcaps.core.geometry import matrix_from_quaternion, transform_from, triangle_areas
from vrcaps.core.units import MM
from vrcaps.tissue.tissue import WinklerFoundation
from vrcaps.world.indentation import _divided, indentation


def irregular_floor(edge: float, size: float = 60.0 * MM) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a level floor, normals up."""
    count = int(size / edge) + 1
    x, y = np.meshgrid(*(np.linspace(-size / 2.0, size / 2.0, count),) * 2, indexing="ij")
    y = y + 0.3 * edge * np.sin(7.0 * x / edge)
    number = np.arange(count * count).reshape(count, count)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    return np.stack([x, y, 0.0 * x], -1).reshape(-1, 3), np.concatenate(faces)


@pytest.mark.parametrize("edge", [4.0, 1.0])
@pytest.mark.parametrize("depth", [0.1, 1.0])
@pytest.mark.parametrize("foundation", [LINEAR, WinklerFoundation(rate_gain=0.0)])
def test_pressure_times_area_is_the_force_of_the_core(edge, depth, foundation):
    vertices, faces = irregular_floor(edge * MM)
    position = (0.3 * MM, 0.1 * MM, RADIUS - depth * MM)
    world = world_on(_core.Wall(vertices, faces), position=position, foundation=foundation)
    world.step(1e-9, 1, (0.0,) * 6, (0.0,) * 3)
    pose = transform_from(matrix_from_quaternion(np.array(LYING)), np.array(position))
    found = indentation(vertices, faces, capsule(), pose)
    force = foundation.static_pressure(found.depth) @ found.areas
    assert force == pytest.approx(world.contact()[2], rel=0.03)
    assert found.areas.sum() == pytest.approx(world.contact()[5], rel=0.08)
    assert found.depth.max() == pytest.approx(depth * MM, rel=0.03)


def test_stiffness_is_the_slope_of_pressure():
    depth, small = np.array([0.0, 0.5, 2.0]) * MM, 1e-9
    for foundation in (LINEAR, WinklerFoundation()):
        rise = foundation.static_pressure(depth + small) - foundation.static_pressure(depth)
        np.testing.assert_allclose(foundation.stiffness_at(depth), rise / small, rtol=1e-5)
        assert foundation.stiffness_at(depth)[0] == foundation.stiffness


def test_far_from_the_wall_and_behind_it_nothing_is_pressed():
    vertices, faces = irregular_floor(2.0 * MM)
    for height, seen in ((20.0, faces), (5.5, faces), (5.0, faces[:, ::-1])):
        place = np.array([0.0, 0.0, height * MM + HALF_AXIS])
        found = indentation(vertices, seen, capsule(), transform_from(np.eye(3), place))
        assert len(found.depth) == len(found.corners) == 0


def test_pieces_cover_a_triangle_and_keep_its_side():
    corners = np.array(
        [[[0.0, 0, 0], [3.0, 0, 0], [0, 2.0, 0]], [[0, 0, 0], [0, 1.0, 0], [1.0, 0, 0]]]
    )
    pieces = _divided(corners, 0.8)
    assert len(pieces) == 2 * 5**2
    areas = triangle_areas(pieces).reshape(2, -1)
    np.testing.assert_allclose(areas.sum(axis=1), triangle_areas(corners))
    np.testing.assert_allclose(areas, areas[:, :1] * np.ones(25))
    ahead = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])[:, 2]
    assert (ahead[:25] > 0.0).all()
    assert (ahead[25:] < 0.0).all()
