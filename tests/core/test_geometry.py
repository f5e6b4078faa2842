"""Vectors and triangles against closed forms and NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.geometry import (
    barycentric,
    cross_products,
    detour,
    edge_graph,
    smoothstep,
    triangle_areas,
    triangle_normals,
    unit,
)

CORNERS = np.random.default_rng(0).normal(size=(50, 3, 3))


def test_unit_vectors_have_length_1_and_zero_stays_zero():
    vectors = np.array([[3.0, 0.0, 4.0], [0.0, 0.0, 0.0], [0.0, 1e-150, 0.0]])
    assert unit(vectors) == pytest.approx(np.array([[0.6, 0.0, 0.8], [0, 0, 0], [0, 1, 0]]))
    assert np.linalg.norm(unit(CORNERS), axis=-1) == pytest.approx(1.0)


def test_smoothstep_is_a_cubic_between_its_ends():
    x = np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0])
    assert smoothstep(x) == pytest.approx([0.0, 0.0, 3 / 16 - 2 / 64, 0.5, 1.0, 1.0])


def test_cross_products_are_those_of_numpy_to_the_last_bit():
    first, second = CORNERS[:, 0], CORNERS[:, 1]
    np.testing.assert_array_equal(cross_products(first, second), np.cross(first, second))


def test_areas_and_normals_of_right_triangles():
    corners = np.array([[[0.0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0.0, 0, 0], [0, 0, 0], [1, 1, 1]]])
    assert triangle_areas(corners) == pytest.approx([3.0, 0.0])
    assert triangle_normals(corners)[0] == pytest.approx([0.0, 0.0, 6.0])


def test_barycentric_coordinates_give_the_point_back():
    weights = np.random.default_rng(1).dirichlet(np.ones(3), len(CORNERS))
    points = np.einsum("nc,ncx->nx", weights, CORNERS)
    assert barycentric(points, CORNERS) == pytest.approx(weights, abs=1e-9)


def test_a_point_of_a_triangle_without_area_has_the_first_corner():
    flat = np.zeros((1, 3, 3))
    assert barycentric(np.zeros((1, 3)), flat).tolist() == [[1.0, 0.0, 0.0]]


def test_edge_graph_holds_each_edge_in_both_directions():
    vertices = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [3, 4, 0]])
    graph = edge_graph(vertices, np.array([[0, 1, 2], [1, 3, 2]])).toarray()
    assert graph == pytest.approx(graph.T)
    assert graph[0].tolist() == [0.0, 3.0, 4.0, 0.0]
    assert graph[1, 2] == pytest.approx(5.0)


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
