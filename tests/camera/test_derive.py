import numpy as np
import pytest

from vrcaps.camera.derive import barrel_lens, barrel_radius, focal_length_px, scaled_lens
from vrcaps.camera.lens import LensEquidistant, LensEquirectangular, LensPinhole
from vrcaps.core.errors import InputError


def test_barrel_radius_is_the_division_model() -> None:
    """With q = (1 − D) r′ / R: r / R = q / (1 − λ q²), λ = D / (1 − D)², and R stays."""
    radius, strength = np.linspace(0.0, 300.0, 50), 0.3
    share = 0.7 * barrel_radius(radius, strength, 100.0) / 100.0
    assert share / (1.0 - 0.3 / 0.49 * share**2) == pytest.approx(radius / 100.0, rel=1e-12)
    assert barrel_radius(np.array(100.0), strength, 100.0) == pytest.approx(100.0)


@pytest.mark.parametrize("strength", [0.0, 0.15, 0.4])
def test_barrel_lens_fits_a_simple_lens_closely(strength: float) -> None:
    lens = LensEquidistant(100.0, 160.0, 150.0, 1.4)
    bent = barrel_lens(lens, strength, 130.0)
    angle = np.linspace(0.0, 1.39, 60)
    rays = np.stack([np.sin(angle), np.zeros(60), np.cos(angle)], axis=-1)
    radius = bent.project(rays)[:, 0] - 160.0
    assert np.abs(radius - barrel_radius(100.0 * angle, strength, 130.0)).max() < 0.35
    assert (np.diff(radius) > 0.0).all()
    assert (bent.cx, bent.cy) == (160.0, 150.0)


def test_scaled_lens_and_focal_length() -> None:
    lens = LensPinhole(50.0, 54.0, 40.0, 30.0, k1=-0.02)
    assert focal_length_px(lens) == pytest.approx(52.0, rel=1e-6)
    assert focal_length_px(scaled_lens(lens, 0.5, (20.0, 15.0))) == pytest.approx(26.0, rel=1e-6)


def test_a_whole_sphere_has_no_barrel() -> None:
    with pytest.raises(InputError, match="equirectangular has no image radius"):
        barrel_lens(LensEquirectangular(50.0, 50.0, 159.5, 79.5), 0.1, 80.0)
