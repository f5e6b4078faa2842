"""Radiosity through tissue: half-spaces, a sheet lit from behind, path tracing, same bytes."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.validation.scattering_theory import half_space_reflectance
from tests.support.shapes import looking, make_camera, make_model, make_organ, pinhole, sphere, tube
from tests.support.threads import digest_at_rest_and_moved, digests_by_threads
from vrcaps.camera.camera import Camera, Led
from vrcaps.camera.lens import LensEquidistant
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer
from vrcaps.render.scattering import TISSUE_IOR, albedo_roots, diffuse_transmittance, fresnel
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

PLACE = (0.004, -0.003, 0.04)
DOWN = (0.0, 0.0, -1.0)


def _radiance(model: Model, camera: Camera, state: State, **settings: object) -> np.ndarray:
    chosen = {"light": "radiosity", "shadows": True, "scattering": True, **settings}
    renderer = Renderer(model, RenderSettings(**chosen))  # type: ignore[arg-type]
    radiance = renderer.render(state, camera, channels=("radiance",)).radiance
    assert radiance is not None
    return radiance.astype(float)


def _matt(*color: int) -> Appearance:
    """A look that mirrors nothing, so that all light goes through tissue."""
    flat = np.full((1, 1, 3), color, np.uint8)
    return Appearance(
        flat, np.full((1, 1), 128, np.uint8), np.zeros((1, 1)), ior=1.0, clearcoat=0.0
    )


def _sheet(height: float, side: float, cells: int, *, up: bool) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a level square at a height, whose normals point up or down."""
    line = np.linspace(-side / 2, side / 2, cells + 1)
    x, y = np.meshgrid(line, line)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1)
    row, column = (a.ravel() for a in np.mgrid[:cells, :cells])
    a = row * (cells + 1) + column
    b, c, d = a + 1, a + cells + 2, a + cells + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return vertices, faces if up else faces[:, ::-1]


def _lamp(height: float) -> tuple[Led, ...]:
    return (Led((0.0, 0.0, height), lobe_exponent=0.0, intensity=(1e-3, 1e-3, 1e-3)),)


def _folds(around: int = 16, pixels: int = 48) -> tuple[Model, Camera]:
    look = Appearance(
        np.array([[[190, 90, 50]]], np.uint8), np.full((1, 1), 160, np.uint8), np.zeros((1, 1)),
        clearcoat=0.7,
    )  # fmt: skip
    organ = tube(around, 5 * around // 2, length=0.15, folds=0.35, capped=True, appearance=look)
    leds = tuple(Led((0.003 * np.cos(a), 0.003 * np.sin(a), -0.001)) for a in (0.0, 2.0, 4.0))
    camera = make_camera(pinhole(pixels, 1.8), leds=leds)
    return make_model(organ, camera), camera


@pytest.mark.slow
@pytest.mark.parametrize("cells", [20, 200])
def test_a_level_wall_is_a_half_space(cells: int) -> None:
    """Seen and lit head-on from afar: exact transport, in all colors, by coarse and fine faces."""
    away, colors = 0.3, (90, 190, 240)
    camera = make_camera(pinhole(16, 0.05), leds=_lamp(0.0))
    organ = make_organ(*_sheet(0.0, 0.1, cells, up=True), appearance=_matt(*colors))
    found = _radiance(make_model(organ, camera), camera, looking((0.0, 0.0, away), DOWN))
    linear = ((np.array(colors) / 255 + 0.055) / 1.055) ** 2.4
    roots = np.interp(linear, np.linspace(0.0, 1.0, len(albedo_roots())), albedo_roots())
    passes = 1.0 - fresnel(np.array(1.0), TISSUE_IOR)
    back = half_space_reflectance(1.0 - roots**2, TISSUE_IOR)
    expected = 1e-3 / away**2 / np.pi * back * passes / diffuse_transmittance(TISSUE_IOR) ** 2
    np.testing.assert_allclose(found.mean(axis=(0, 1)), expected, rtol=0.02)
    assert (found.std(axis=(0, 1)) < 0.02 * expected).all()


def test_a_thin_sheet_shines_through() -> None:
    """Lit from behind, nearly as bright as by path tracing; without scattering it is black.

    Through a sheet seen head-on more comes than on average, which rows do not know.
    """
    top, faces = _sheet(0.0, 0.06, 40, up=True)
    bottom, others = _sheet(-1e-3, 0.06, 40, up=False)
    camera = make_camera(pinhole(16, 0.3), leds=_lamp(0.06))
    organ = make_organ(
        np.vstack([top, bottom]),
        np.vstack([faces, others + len(top)]),
        appearance=_matt(190, 150, 90),
    )
    model, state = make_model(organ, camera), looking((0.0, 0.0, 0.03), DOWN)
    found = _radiance(model, camera, state).mean(axis=(0, 1))
    assert not _radiance(model, camera, state, scattering=False).any()
    paths = _radiance(model, camera, state, light="path", spp=128, max_bounces=1)
    np.testing.assert_allclose(found, paths.mean(axis=(0, 1)), rtol=0.25)


@pytest.mark.slow
def test_beside_folds_as_by_path_tracing() -> None:
    """Two renderings cancel path tracing's noise; without scattering red is far off."""
    model, camera = _folds(48, pixels=32)
    state = looking(PLACE)
    one, two = (
        _radiance(model, camera, state, light="path", spp=48, max_bounces=8, path_seed=seed)
        for seed in (0, 1)
    )
    mean = one.mean(axis=(0, 1))

    def error(image: np.ndarray) -> np.ndarray:
        square = np.mean((image - one) * (image - two), axis=(0, 1))
        return np.sqrt(np.maximum(square, 0.0)) / mean

    ours, plain = (_radiance(model, camera, state, scattering=on) for on in (True, False))
    assert (error(ours) < 0.15).all()
    assert error(ours)[0] < 0.5 * error(plain)[0]
    np.testing.assert_allclose(ours.mean(axis=(0, 1)), mean, rtol=0.06)


@pytest.mark.slow
def test_nobody_gives_back_more_than_arrives() -> None:
    """A hollow sphere glows at most by 1/(1 − ρ), and the less the narrower it is."""
    camera = make_camera((LensEquidistant(8.0, 12.0, 12.0), 25, 25), leds=_lamp(0.0))
    color = ((np.array([220, 190, 120]) / 255 + 0.055) / 1.055) ** 2.4
    passes = (1.0 - fresnel(np.array(1.0), TISSUE_IOR)) / diffuse_transmittance(TISSUE_IOR)
    glow = []
    for radius in (0.004, 0.016):
        model = make_model(sphere(3, radius=radius, appearance=_matt(220, 190, 120)), camera)
        found = _radiance(model, camera, looking((0.0, 0.0, 0.0))).mean(axis=(0, 1))
        most = 1e-3 / radius**2 / np.pi * passes**2 * color / (1.0 - color)
        glow.append(found / most)
    assert (glow[1] < 1.03).all()
    assert (glow[0][:2] < glow[1][:2]).all()
    assert glow[0][0] < 0.8


@pytest.mark.slow
def test_a_moved_wall_is_lit_as_it_is() -> None:
    """A wall that is carried along with the capsule looks the same."""
    model, camera = _folds()
    offset = np.array([0.01, -0.02, 0.015])
    still = _radiance(model, camera, looking(PLACE))
    place = tuple(np.array(PLACE) + offset)
    moved = looking(place, vertices_world=model.organ.vertices + offset)
    assert np.mean(np.abs(_radiance(model, camera, moved) - still)) < 2e-3 * still.mean()


def test_labels_stay_and_narrow_bands_work() -> None:
    model, camera = _folds()
    names = ("depth", "normal", "label", "albedo", "position")
    frames = [
        Renderer(
            model, RenderSettings(light="radiosity", scattering=on, imaging="narrow-band")
        ).render(looking(PLACE), camera, channels=(*names, "rgb"))
        for on in (False, True)
    ]
    for name in names:
        np.testing.assert_array_equal(*(getattr(frame, name) for frame in frames))
    assert (frames[0].rgb != frames[1].rgb).any()


def digest() -> str:
    """Checksum of frames at rest and moved, for processes with other numbers of threads."""
    model, camera = _folds()
    renderer = Renderer(model, RenderSettings(light="radiosity", scattering=True, shadows=True))
    return digest_at_rest_and_moved(renderer, camera, PLACE)


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads() -> None:
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert digests == {digest()}


@pytest.mark.slow
def test_a_frame_does_not_depend_on_what_was_rendered_before() -> None:
    model, camera = _folds()
    state, settings = looking(PLACE), RenderSettings(light="radiosity", scattering=True)
    fresh = Renderer(model, settings).render(state, camera, channels=("radiance",)).radiance
    used = Renderer(model, settings)
    for z in (0.1, 0.02):
        used.render(looking((0.001, 0.002, z)), camera)
    again = used.render(state, camera, channels=("radiance",)).radiance
    np.testing.assert_array_equal(fresh, again)
