"""Denoised path tracing is nearer the truth, keeps what is exact, and says what it lacks."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import looking, make_camera, make_model, patterned, pinhole, tube
from tests.support.threads import digests_by_threads
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.render.renderer import Renderer
from vrcaps.render.sampling import denoise
from vrcaps.render.settings import RenderSettings

PATHS = RenderSettings(light="path", spp=4, max_bounces=3)


def _image(size: int = 64, **settings) -> dict[str, np.ndarray]:
    look = patterned(np.random.default_rng(2), relief=1e-4)
    organ = tube(60, 120, folds=0.35, capped=True, appearance=look)
    camera = make_camera(pinhole(size, 1.8))
    renderer = Renderer(make_model(organ, camera), replace(PATHS, **settings))
    names = ("rgb", "radiance", "depth", "albedo", "normal")
    frame = renderer.render(looking((0.004, -0.003, 0.05)), camera, channels=names)
    return {name: getattr(frame, name) for name in names}


def digest() -> str:
    return hashlib.sha256(_image(denoise=True)["radiance"].tobytes()).hexdigest()


@pytest.mark.slow
def test_error_falls_to_less_than_half() -> None:
    pytest.importorskip("pyoidn")
    noisy, clean, exact = _image(), _image(denoise=True), _image(spp=128, path_seed=1)
    truth = exact["radiance"]
    errors = [np.sqrt(np.mean((i["radiance"] - truth) ** 2)) for i in (noisy, clean)]
    assert errors[1] < 0.5 * errors[0]
    np.testing.assert_allclose(clean["radiance"].mean(), truth.mean(), rtol=0.01)
    errors = [np.mean(np.abs(i["rgb"].astype(float) - exact["rgb"])) for i in (noisy, clean)]
    assert errors[1] < 0.5 * errors[0]
    for name in ("depth", "albedo", "normal"):
        np.testing.assert_array_equal(clean[name], noisy[name])


def test_the_first_reflection_is_left_as_it_is() -> None:
    pytest.importorskip("pyoidn")
    for supersampling in (1, 2):
        given = {"max_bounces": 1, "supersampling": supersampling}
        exact, kept = (_image(**given, denoise=d)["radiance"] for d in (False, True))
        np.testing.assert_allclose(kept, exact, rtol=1e-6, atol=5e-3 * exact.mean())


@pytest.mark.slow
def test_supersampled_images_are_denoised_too() -> None:
    pytest.importorskip("pyoidn")
    fine = _image(supersampling=2, denoise=True)["radiance"]
    truth = _image(supersampling=2, spp=48, path_seed=1)["radiance"]
    noisy = _image(supersampling=2)["radiance"]
    errors = [np.sqrt(np.mean((image - truth) ** 2)) for image in (noisy, fine)]
    assert errors[1] < 0.6 * errors[0]


def test_pixels_without_a_surface_stay_black() -> None:
    pytest.importorskip("pyoidn")
    radiance = np.zeros((40, 40, 3), np.float32)
    radiance[:, 20:] = 1.0
    nothing = np.full_like(radiance, np.nan)
    nothing[:, 20:] = 0.5
    found = denoise(radiance, np.zeros_like(radiance), nothing, nothing)
    assert np.isfinite(found).all()
    assert found[:, :18].max() < 0.01
    np.testing.assert_allclose(found[4:-4, 24:-4], 1.0, atol=0.1)


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads() -> None:
    pytest.importorskip("pyoidn")
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert digests == {digest()}


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'vrcaps\[denoise\]'"):
        _image(denoise=True)


def test_only_path_tracing_has_noise() -> None:
    with pytest.raises(
        InputError, match=r"denoise requires path tracing, but light is 'radiosity'"
    ):
        RenderSettings(light="radiosity", denoise=True)
