"""Distances between sets of images: closed forms, invariances, bad input."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.metrics.appearance import (
    at_most_per_group,
    coverage,
    distinct_images,
    frechet_distance,
    kernel_distance,
    nearest_images,
    principal_axes,
    standardized,
)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_standardized_features_have_mean_zero_and_deviation_one(rng: np.random.Generator):
    real = rng.uniform(5.0, 7.0, (500, 4))
    z = standardized(real, real)
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(z.std(axis=0), 1.0, rtol=1e-12)


def test_standardized_features_are_limited_and_constants_are_zero(rng: np.random.Generator):
    real = rng.standard_normal((50, 2))
    real[:, 1] = 4.0
    ours = np.array([[100.0, 4.0], [-100.0, 9.0], [0.0, 1.0]])
    z = standardized(ours, real)
    assert z[0, 0] == 3.0
    assert z[1, 0] == -3.0
    np.testing.assert_array_equal(z[:, 1], 0.0)


def pairwise_kid(x: np.ndarray, y: np.ndarray) -> float:
    """KID by its definition, pair by pair."""

    def k(a: np.ndarray, b: np.ndarray) -> float:
        return (float(a @ b) / len(a) + 1.0) ** 3

    own = np.mean([k(a, b) for i, a in enumerate(x) for j, b in enumerate(x) if i != j])
    other = np.mean([k(a, b) for i, a in enumerate(y) for j, b in enumerate(y) if i != j])
    return float(own + other - 2.0 * np.mean([k(a, b) for a in x for b in y]))


def test_kernel_distance_equals_its_definition(rng: np.random.Generator):
    x, y = rng.standard_normal((7, 3)), 0.5 + rng.standard_normal((9, 3))
    assert kernel_distance(x, y, resamples=2).value == pytest.approx(pairwise_kid(x, y), rel=1e-12)


def test_kernel_distance_is_unbiased_for_one_distribution():
    values = []
    for seed in range(200):
        x, y = np.random.default_rng(seed).standard_normal((2, 30, 4))
        values.append(kernel_distance(x, y, resamples=2).value)
    error = np.std(values) / np.sqrt(len(values))
    assert abs(np.mean(values)) < 3.0 * error


def test_kernel_distance_of_shifted_points_in_closed_form():
    """Two point masses 0 and a in one dimension: k(0,0) + k(a,a) - 2 k(0,a) = (a² + 1)³ - 1."""
    zeros, shifted = np.zeros((5, 1)), np.full((4, 1), 2.0)
    assert kernel_distance(zeros, shifted, resamples=2).value == pytest.approx(5.0**3 - 1.0)


def test_groups_widen_the_interval(rng: np.random.Generator):
    centers = 2.0 * rng.standard_normal((6, 3))
    groups = np.repeat(np.arange(6), 20)
    x = centers[groups] + 0.1 * rng.standard_normal((120, 3))
    y = rng.standard_normal((120, 3))
    alone = kernel_distance(x, y)
    grouped = kernel_distance(x, y, groups=groups)
    assert grouped.value == alone.value
    assert grouped.half_width > 2.0 * alone.half_width


def test_frechet_distance_of_normals_in_closed_form(rng: np.random.Generator):
    """|m1 - m2|² + Σ (σ1 - σ2)² for diagonal covariances."""
    z = rng.standard_normal((400, 2))
    z = (z - z.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(z, rowvar=False))).T
    ours, real = 3.0 * z + [1.0, -2.0], z * [1.0, 2.0]
    expected = 5.0 + (3.0 - 1.0) ** 2 + (3.0 - 2.0) ** 2
    assert frechet_distance(ours, real) == pytest.approx(expected, rel=1e-9)


def test_coverage_of_copies_is_one_and_of_a_distant_point_zero(rng: np.random.Generator):
    real = rng.standard_normal((60, 3))
    assert coverage(real, real) == 1.0
    assert coverage(np.full((60, 3), 50.0), real) == 0.0
    half = coverage(real[real[:, 0] > 0.0], real)
    assert 0.4 < half < 0.9


def test_nearest_images(rng: np.random.Generator):
    real = rng.standard_normal((20, 4))
    index, distance = nearest_images(real[::-1], real)
    np.testing.assert_array_equal(index, np.arange(20)[::-1])
    np.testing.assert_allclose(distance, 0.0, atol=1e-6)


def test_principal_axes_are_orthonormal_and_ordered(rng: np.random.Generator):
    x = rng.standard_normal((300, 5)) * [1.0, 9.0, 3.0, 0.1, 0.5]
    axes = principal_axes(x, 3)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(np.abs(axes).argmax(axis=0), [1, 2, 0])


def test_distinct_images_keep_the_first_of_each_cluster(rng: np.random.Generator):
    base = np.eye(4)[[0, 1, 2]] + 0.01 * rng.standard_normal((3, 4))
    features = base[[0, 0, 1, 0, 2, 1]] * [[1.0], [3.0], [1.0], [0.2], [1.0], [5.0]]
    np.testing.assert_array_equal(distinct_images(features), [0, 2, 4])


def test_at_most_per_group(rng: np.random.Generator):
    groups = np.array(["a"] * 5 + ["b"] * 2)
    chosen = at_most_per_group(groups, 3)
    assert (groups[chosen] == "a").sum() == 3
    assert (groups[chosen] == "b").sum() == 2
    np.testing.assert_array_equal(chosen, np.sort(chosen))


def test_bad_input(rng: np.random.Generator):
    few, many = rng.standard_normal((2, 3)), rng.standard_normal((9, 3))
    with pytest.raises(InputError, match=r"number of images is 2\. Allowed: 3 or more"):
        standardized(few, many)
    with pytest.raises(InputError, match=r"number of images is 2\. Allowed: 3 or more"):
        kernel_distance(many, few)
    with pytest.raises(InputError, match="The sets have 3 and 2 features"):
        standardized(many, many[:, :2])
    with pytest.raises(InputError, match=r"number of real images is 5\. Allowed: 6 or more"):
        coverage(many, many[:5])
