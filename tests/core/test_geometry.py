"""Vectors and triangles against closed forms and NumPy."""

import numpy as np
import pytest

from vrcaps.core.geometry import (
    barycentric,
    cross_products,
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
