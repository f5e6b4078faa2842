"""Properties of every lens model, for random parameters."""

import inspect
import math

import numpy as np
import pytest

from tests.support.random_lens import random_lens
from vrcaps.camera.lens import (
    LENSES,
    LensEquidistant,
    LensEquirectangular,
    LensKannalaBrandt,
    LensPinhole,
    LensScaramuzza,
)
from vrcaps.core.errors import InputError

SIZE = 200


def grid() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("kind", LENSES)
def test_unproject_then_project_returns_every_pixel(kind, seed):
    lens = random_lens(kind, np.random.default_rng(seed))
    rays = lens.unproject(grid())
    valid = np.isfinite(rays).all(axis=-1)
    assert valid.any()
    assert np.isnan(rays[~valid]).all()
    np.testing.assert_allclose(np.linalg.norm(rays[valid], axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(lens.project(rays)[valid], grid()[valid], atol=1e-8)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("kind", LENSES)
def test_project_then_unproject_returns_every_ray_of_the_field(kind, seed):
    rng = np.random.default_rng(seed)
    lens = random_lens(kind, rng)
    points = rng.normal(size=(4000, 3)) * rng.uniform(1e-3, 1e3, (4000, 1))
    pixels = lens.project(points)
    valid = np.isfinite(pixels).all(axis=-1)
    rays = lens.unproject(pixels[valid])
    unit = points[valid] / np.linalg.norm(points[valid], axis=-1, keepdims=True)
    assert valid.any()
    # Where the image radius turns over, the angle answers to rounding like its square root.
    np.testing.assert_allclose(rays, unit, atol=1e-6)


@pytest.mark.parametrize("kind", LENSES)
def test_optical_axis_is_the_center_pixel(kind):
    lens = random_lens(kind, np.random.default_rng(3))
    center = np.array([lens.cx, lens.cy])
    np.testing.assert_allclose(lens.project(np.array([0.0, 0.0, 2.0])), center, atol=1e-12)
    np.testing.assert_allclose(lens.unproject(center), [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("kind", LENSES)
def test_x_is_right_and_y_is_down(kind):
    lens = random_lens(kind, np.random.default_rng(4))
    assert lens.project(np.array([0.1, 0.0, 1.0]))[0] > lens.cx
    assert lens.project(np.array([0.0, 0.1, 1.0]))[1] > lens.cy


@pytest.mark.parametrize("kind", LENSES)
def test_max_angle_bounds_the_field(kind):
    rng = np.random.default_rng(5)
    lens = {
        "pinhole": LensPinhole(80, 80, 100, 100, max_angle=0.7),
        "kannala-brandt": LensKannalaBrandt(80, 80, 100, 100, max_angle=0.7),
        "scaramuzza": LensScaramuzza(80, 0, 0, 0, 100, 100, max_angle=0.7),
        "equidistant": LensEquidistant(80, 100, 100, 0.7),
        "equirectangular": LensEquirectangular(80, 80, 100, 100, 0.7),
    }[kind]
    points = rng.normal(size=(5000, 3))
    angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    np.testing.assert_array_equal(np.isfinite(lens.project(points)[:, 0]), angle <= 0.7)
    rays = lens.unproject(grid()).reshape(-1, 3)
    rays = rays[np.isfinite(rays[:, 0])]
    assert np.arccos(rays[:, 2]).max() == pytest.approx(0.7, abs=0.02)
    assert np.arccos(rays[:, 2]).max() <= 0.7 + 1e-9


@pytest.mark.parametrize("kind", LENSES)
def test_nothing_is_seen_through_nan_or_the_origin(kind):
    lens = random_lens(kind, np.random.default_rng(6))
    assert np.isnan(lens.project(np.zeros(3))).all()
    assert np.isnan(lens.project(np.full((2, 3), np.nan))).all()
    assert np.isnan(lens.unproject(np.full((2, 2), np.nan))).all()


@pytest.mark.parametrize("kind", LENSES)
def test_lenses_are_flat_records_of_plain_numbers(kind):
    lens = random_lens(kind, np.random.default_rng(7))
    values = [getattr(lens, name) for name in inspect.signature(type(lens)).parameters]
    assert all(value is None or isinstance(value, (int, float)) for value in values)
    assert type(lens)(*values) == lens
    assert lens.kind == kind


def test_equidistant_radius_is_proportional_to_the_angle():
    lens = LensEquidistant(focal=50.0, cx=100.0, cy=100.0)
    for angle in (0.1, 1.0, 2.0, 3.0):
        pixel = lens.project(np.array([math.sin(angle), 0.0, math.cos(angle)]))
        np.testing.assert_allclose(pixel, [100.0 + 50.0 * angle, 100.0], atol=1e-12)


def test_equirectangular_covers_the_sphere_once():
    """Each pixel's ray stands for its solid angle cos β dλ dβ; they add up to 4π."""
    focal = 100.0 / math.pi
    lens = LensEquirectangular(focal, focal, 99.5, 49.5)
    pixels = np.stack(np.meshgrid(np.arange(200), np.arange(100)), axis=-1).astype(float)
    rays = lens.unproject(pixels)
    assert np.isfinite(rays).all()
    solid_angle = np.sqrt(1.0 - rays[..., 1] ** 2) / focal**2
    assert solid_angle.sum() == pytest.approx(4.0 * math.pi, rel=1e-4)
    np.testing.assert_allclose(rays.reshape(-1, 3).sum(axis=0), 0.0, atol=1e-9)


def test_equirectangular_sees_nothing_beyond_the_sphere():
    lens = LensEquirectangular(10.0, 10.0, 99.5, 49.5)
    assert np.isnan(lens.unproject(np.array([[0.0, 49.5], [99.5, 0.0]]))).all()


def test_kannala_brandt_field_ends_where_the_radius_turns():
    """r = θ - θ³/3 turns at θ = 1, where it is 2/3."""
    lens = LensKannalaBrandt(100.0, 100.0, 0.0, 0.0, k1=-1.0 / 3.0)
    assert lens.limit == pytest.approx(1.0, abs=1e-12)
    at = [lens.project(np.array([math.sin(a), 0.0, math.cos(a)]))[0] for a in (0.999, 1.001)]
    assert at[0] == pytest.approx(200.0 / 3.0, abs=1e-3)
    assert math.isnan(at[1])
    assert np.isnan(lens.unproject(np.array([66.67, 0.0]))).all()


def test_scaramuzza_field_ends_where_the_angle_turns():
    """f = a0 + a2 r² with a2 > 0 turns at r = √(a0 / a2)."""
    lens = LensScaramuzza(100.0, 0.01, 0.0, 0.0, 0.0, 0.0)
    assert lens.limit == pytest.approx(100.0, abs=1e-9)
    assert np.isfinite(lens.unproject(np.array([99.9, 0.0]))).all()
    assert np.isnan(lens.unproject(np.array([100.1, 0.0]))).all()


def test_pinhole_field_ends_where_the_radius_turns():
    """r' = r - r³/3 turns at r = 1, where it is 2/3."""
    lens = LensPinhole(100.0, 100.0, 0.0, 0.0, k1=-1.0 / 3.0)
    assert lens.limit == pytest.approx(1.0, abs=1e-12)
    assert np.isfinite(lens.unproject(np.array([66.66, 0.0]))).all()
    assert np.isnan(lens.unproject(np.array([66.67, 0.0]))).all()
    assert np.isnan(lens.project(np.array([1.001, 0.0, 1.0]))).all()


def test_pinhole_sees_nothing_behind_it():
    assert np.isnan(
        LensPinhole(100, 100, 0, 0).project(np.array([[0.1, 0, -1.0], [1, 0, 0]]))
    ).all()


@pytest.mark.parametrize("value", [math.nan, math.inf, "100", True, None])
def test_parameters_must_be_finite_numbers(value):
    with pytest.raises(InputError, match=r"Lens pinhole: cx = .*\. Allowed: a finite number\."):
        LensPinhole(100.0, 100.0, value, 50.0)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: LensPinhole(0.0, 1.0, 0.0, 0.0), "Lens pinhole: fx = 0.0. Allowed: above 0"),
        (lambda: LensKannalaBrandt(1.0, -1.0, 0.0, 0.0), "fy = -1.0. Allowed: above 0"),
        (lambda: LensEquidistant(-2.0, 0.0, 0.0), "focal = -2.0. Allowed: above 0"),
        (lambda: LensEquirectangular(1.0, 0.0, 0.0, 0.0), "fy = 0.0. Allowed: above 0"),
        (lambda: LensScaramuzza(-5.0, 0, 0, 0, 0, 0), "does not increase with the radius"),
        (lambda: LensScaramuzza(5.0, 0, 0, 0, 0, 0, 0.0), r"stretch c - d e = 0.0. Allowed: above"),
        (lambda: LensEquidistant(2.0, 0.0, 0.0, 4.0), "max_angle = 4.0. Allowed: above 0 to π rad"),
        (lambda: LensEquidistant(2.0, 0.0, 0.0, 0.0), "max_angle = 0.0. Allowed: above 0 to π rad"),
    ],
)
def test_impossible_parameters_are_refused(make, text):
    with pytest.raises(InputError, match=text):
        make()
