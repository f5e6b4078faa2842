"""Shape functions and integration on simplices."""

from math import factorial

import numpy as np
import pytest

from vrcaps.tissue.fem.layer import EDGES, quadrature, shapes


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("num", [1, 2, 3])
def test_quadrature_is_exact_to_its_degree(dim: int, num: int) -> None:
    """∫ x^a y^b z^c over the unit simplex is a! b! c! / (a + b + c + dim)!."""
    points, weights = quadrature(dim, num)
    assert (weights > 0.0).all()
    powers = np.stack(np.meshgrid(*[np.arange(2 * num)] * dim), -1).reshape(-1, dim)
    for power in powers[powers.sum(1) <= 2 * num - 1]:
        exact = np.prod([factorial(k) for k in power]) / factorial(power.sum() + dim)
        assert (weights * (points**power).prod(1)).sum() == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_shapes_are_one_at_their_node_and_slope_as_they_should(dim: int) -> None:
    corners = np.concatenate([np.zeros((1, dim)), np.eye(dim)])
    pairs = EDGES[:3] if dim == 2 else EDGES
    nodes = np.concatenate([corners, [(corners[a] + corners[b]) / 2 for a, b in pairs]])
    np.testing.assert_allclose(shapes(nodes)[0], np.eye(len(nodes)), atol=1e-15)
    points = np.random.default_rng(0).uniform(0.0, 0.5, (20, dim))
    for k in range(dim):
        step = 1e-6 * np.eye(dim)[k]
        slope = (shapes(points + step)[0] - shapes(points - step)[0]) / 2e-6
        np.testing.assert_allclose(shapes(points)[1][..., k], slope, atol=1e-8)
