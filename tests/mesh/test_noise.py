import numpy as np
import pytest

from vrcaps.mesh.noise import angular_harmonics, band_pass, fbm, low_pass


@pytest.mark.parametrize("make", [fbm, low_pass, band_pass])
def test_unit_variance_and_same_seed(make):
    points = np.random.default_rng(1).uniform(0, 1.0, (20_000, 3))
    values = make(0.01, np.random.default_rng(0))(points)
    assert values.mean() == pytest.approx(0.0, abs=0.05)
    assert values.std() == pytest.approx(0.9, abs=0.15)  # linear interpolation takes some
    assert np.array_equal(values, make(0.01, np.random.default_rng(0))(points))


def test_wavelength():
    """A narrow band of waves of length λ crosses zero about 2/(√3 λ) times per length (Rice)."""
    field = band_pass(0.5, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    rates = []
    for _ in range(60):
        way = rng.normal(size=3)
        line = rng.uniform(0, 9, 3) + np.linspace(0, 4.0, 4000)[:, None] * way / np.linalg.norm(way)
        rates.append((np.diff(np.sign(field(line))) != 0).sum() / 4.0)
    assert np.mean(rates) == pytest.approx(2 / (3**0.5 * 0.5), rel=0.1)


def test_outline_is_periodic_and_bounded():
    function = angular_harmonics(5, np.random.default_rng(0))
    angle = np.linspace(-np.pi, np.pi, 1000)
    assert function(angle)[0] == pytest.approx(function(angle)[-1])
    assert np.abs(function(angle)).max() < 2.5
