"""The wet film: how much of a wall it covers, levels and darkens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import looking, make_camera, make_model, patterned, tube
from vrcaps.core.errors import InputError
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.scattering import internal_reflectance
from vrcaps.render.scene import apply_mucus_film, covered_fraction, dry_albedo, level_relief
from vrcaps.render.settings import RenderSettings


@pytest.fixture
def organ(rng: np.random.Generator) -> OrganSurface:
    look = replace(patterned(rng, size=(96, 128), relief=2e-4), clearcoat=0.8)
    return tube(48, 60, length=0.1, capped=True, appearance=look)


@pytest.mark.parametrize("thickness", [0.01, 0.4, 1.0, 3.0])
def test_share_under_liquid(thickness: float, rng: np.random.Generator):
    """On drawn heights, liquid up to where that share lies has the volume asked for."""
    heights = np.sort(rng.normal(size=200_000))
    share = covered_fraction(thickness)
    level = heights[min(int(share * len(heights)), len(heights) - 1)]
    if share < 0.99:
        volume = np.mean(np.maximum(level - heights, 0.0))
        assert volume == pytest.approx(thickness, rel=0.03)
    assert share >= covered_fraction(0.5 * thickness)


def test_share_of_the_limits():
    assert covered_fraction(0.0) == 0.0
    assert covered_fraction(1.0 / np.sqrt(2.0 * np.pi)) == pytest.approx(0.5)
    assert covered_fraction(1e3) == pytest.approx(1.0)


def test_film_throws_light_back():
    """The series of light thrown back and reflected again gives the wet color."""
    wet = np.linspace(0.0, 1.0, 21)
    dry, share = dry_albedo(wet), internal_reflectance(1.335)
    series = sum(dry * (1.0 - share) * (share * dry) ** k for k in range(200))
    np.testing.assert_allclose(series, wet, atol=1e-9)
    assert (dry[1:-1] > wet[1:-1]).all()


def test_liquid_fills_dips(rng: np.random.Generator):
    """It has its volume, stands above the wall, is level, and flattens more the more there is."""
    height = 1e-4 * rng.random((64, 80)).astype(np.float32)
    slopes = []
    for thickness in (0.0, 1e-5, 4e-5, 2e-4):
        level = level_relief(height, thickness, 200)  # as wide as the texture: one level
        added = level - height
        assert added.min() > -1e-9
        assert added.mean() == pytest.approx(thickness, rel=5e-3, abs=1e-9)
        slopes.append(np.abs(np.diff(level, axis=1)).mean())
    assert slopes[0] > slopes[1] > slopes[2] > slopes[3] < 1e-2 * slopes[0]
    np.testing.assert_array_equal(level_relief(height, 0.0, 9), height)


def test_coat_and_color_follow_thickness(organ: OrganSurface):
    looks = [apply_mucus_film(organ, 1e-6 * t).appearance for t in (0.0, 1.0, 5.0, 20.0)]
    coats = [look.clearcoat for look in looks if look is not None]
    means = [look.albedo.mean() for look in looks if look is not None]
    assert coats[0] == 0.0
    assert coats[-1] == pytest.approx(0.8, rel=1e-3)
    assert (np.diff(coats) > 0.0).all()
    assert (np.diff(means) < 0.0).all()
    assert organ.appearance is not None
    np.testing.assert_array_equal(looks[-1].albedo, organ.appearance.albedo)


def test_images_follow_thickness(organ: OrganSurface):
    """A dry wall is brighter and without highlights; labels and depth stay."""
    camera = make_camera("equidistant")
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.05))
    frames = [
        Renderer(model, RenderSettings(light="direct", mucus_film_um=film)).render(
            state, camera, channels=("radiance", "depth", "label")
        )
        for film in (0.0, 100.0)
    ]
    dry, wet = (np.asarray(frame.radiance, float).mean(axis=2) for frame in frames)
    assert np.median(dry[dry > 0.0]) > 1.05 * np.median(wet[wet > 0.0])
    assert wet.max() / np.median(wet[wet > 0.0]) > dry.max() / np.median(dry[dry > 0.0])
    for name in ("depth", "label"):
        np.testing.assert_array_equal(*(getattr(frame, name) for frame in frames))


def test_wrong_input(organ: OrganSurface):
    with pytest.raises(InputError, match=r"mucus_film_um is -1\.0\. Allowed: 0 to 1000 µm\."):
        RenderSettings(light="direct", mucus_film_um=-1.0)
    with pytest.raises(
        InputError, match=r"shape has no appearance, so it cannot have a mucus film"
    ):
        apply_mucus_film(replace(organ, appearance=None), 1e-5)
