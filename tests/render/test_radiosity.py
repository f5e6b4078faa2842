"""Bounced light as radiosity: the integrating sphere, path tracing beside folds, same bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import (
    DIRECT,
    looking,
    make_camera,
    make_model,
    patterned,
    pinhole,
    sphere,
    tube,
)
from tests.support.threads import digest_at_rest_and_moved, digests_by_threads
from vrcaps.camera.camera import Camera, Led
from vrcaps.camera.lens import LensEquidistant
from vrcaps.lumen.contents import Contents, Liquid
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.particles import WHITE, Spheres
from vrcaps.lumen.pools import Pools
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

PLACE = (0.004, -0.003, 0.04)


def _radiance(model: Model, camera: Camera, state: State, **settings: object) -> np.ndarray:
    renderer = Renderer(model, RenderSettings(**settings))  # type: ignore[arg-type]
    radiance = renderer.render(state, camera, channels=("radiance",)).radiance
    assert radiance is not None
    return radiance.astype(float)


def _matt(albedo: int) -> Appearance:
    """A wall without gloss; at this roughness Burley's base is within 2 % of Lambert's."""
    color, rough = np.full((1, 1, 3), albedo, np.uint8), np.full((1, 1), 128, np.uint8)
    return Appearance(color, rough, np.zeros((1, 1)), ior=1.0, clearcoat=0.0)


def _folds(rng: np.random.Generator) -> tuple[Model, Camera]:
    look = patterned(rng, relief=2e-4)
    bright = (120 + look.albedo // 2).astype(np.uint8)
    look = replace(look, albedo=bright, clearcoat_gloss=0.5)
    organ = tube(80, 200, length=0.15, folds=0.35, capped=True, appearance=look)
    leds = tuple(Led((0.003 * np.cos(a), 0.003 * np.sin(a), -0.001)) for a in (0.0, 2.0, 4.0))
    camera = make_camera(pinhole(48, 1.8), leds=leds)
    return make_model(organ, camera), camera


@pytest.mark.parametrize("albedo", [90, 150, 188, 220])
def test_integrating_sphere(albedo: int) -> None:
    """A hollow sphere lit from its middle is brighter than its direct light by 1/(1 − ρ)."""
    camera = make_camera(
        (LensEquidistant(12.0, 19.5, 19.5), 40, 40),
        leds=(Led((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1e-3, 1e-3, 1e-3), 0.0),),
    )
    model, state = make_model(sphere(4, appearance=_matt(albedo)), camera), looking((0.0, 0.0, 0.0))
    direct, all_light = (_radiance(model, camera, state, light=x) for x in ("direct", "radiosity"))
    share = ((albedo / 255 + 0.055) / 1.055) ** 2.4
    ratio = all_light / direct
    assert abs(ratio.mean() * (1.0 - share) - 1.0) < 0.03
    assert ratio.std() < 0.02 * ratio.mean()


@pytest.mark.slow
def test_indirect_light_agrees_with_path_tracing(rng: np.random.Generator) -> None:
    """Beside folds, wet and patterned, with relief: two renderings cancel path tracing's noise."""
    model, camera = _folds(rng)
    state = looking(PLACE)
    ours = _radiance(model, camera, state, light="radiosity", shadows=True)
    one, two = (
        _radiance(model, camera, state, light="path", spp=128, max_bounces=12, path_seed=seed)
        for seed in (0, 1)
    )
    square = np.mean((ours - one) * (ours - two))
    assert np.sqrt(max(square, 0.0)) < 0.06 * one.mean()
    direct = _radiance(model, camera, state, light="direct", shadows=True)
    assert direct.mean() < 0.9 * ours.mean()
    np.testing.assert_allclose((ours - direct).mean(), (one - direct).mean(), rtol=0.06)


@pytest.mark.slow
def test_indirect_light_only_adds_and_scales_with_the_leds(rng: np.random.Generator) -> None:
    model, camera = _folds(rng)
    state = looking(PLACE)
    direct, radiosity = (_radiance(model, camera, state, light=x) for x in ("direct", "radiosity"))
    assert (radiosity >= direct).all()
    brighter = replace(
        camera,
        leds=tuple(
            replace(led, intensity=(2.0 * r, 2.0 * g, 2.0 * b))
            for led in camera.leds
            for r, g, b in [led.intensity]
        ),
    )
    np.testing.assert_allclose(
        _radiance(model, brighter, state, light="radiosity"), 2.0 * radiosity, rtol=1e-5
    )
    dark = _radiance(model, replace(camera, leds=()), state, light="radiosity")
    assert not dark.any()


def test_a_white_wall_stays_finite() -> None:
    """Without absorption, the sum of all reflections diverges; it is truncated."""
    camera = make_camera()
    model = make_model(sphere(3, appearance=_matt(255)), camera)
    found = _radiance(model, camera, looking((0.004, -0.006, 0.003)), light="radiosity")
    assert np.isfinite(found).all()


@pytest.mark.slow
def test_a_moved_wall_is_lit_as_it_is(rng: np.random.Generator) -> None:
    """A wall that is carried along with the capsule looks the same; a widened one does not."""
    model, camera = _folds(rng)
    rest = model.organ.vertices
    offset = np.array([0.01, -0.02, 0.015])
    still = _radiance(model, camera, looking(PLACE), light="radiosity")
    moved = looking(tuple(np.array(PLACE) + offset), vertices_world=rest + offset)
    carried = _radiance(model, camera, moved, light="radiosity")
    assert np.mean(np.abs(carried - still)) < 2e-3 * still.mean()


def digest() -> str:
    """Checksum of frames at rest and moved, for processes with other numbers of threads."""
    model, camera = _folds(np.random.default_rng(3))
    renderer = Renderer(model, RenderSettings(light="radiosity"))
    return digest_at_rest_and_moved(renderer, camera, PLACE)


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads() -> None:
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert digests == {digest()}


@pytest.mark.slow
def test_a_frame_does_not_depend_on_what_was_rendered_before(rng: np.random.Generator) -> None:
    model, camera = _folds(rng)
    state = looking(PLACE)
    fresh = _radiance(model, camera, state, light="radiosity")
    used = Renderer(model, RenderSettings(light="radiosity"))
    for z in (0.1, 0.02, 0.07):
        used.render(looking((0.001, 0.002, z)), camera)
    again = used.render(state, camera, channels=("radiance",)).radiance
    np.testing.assert_array_equal(fresh, again)


@pytest.mark.slow
def test_supersampling_has_indirect_light(rng: np.random.Generator) -> None:
    model, camera = _folds(rng)
    once, fine = (
        _radiance(model, camera, looking(PLACE), light="radiosity", supersampling=n) for n in (1, 2)
    )
    assert abs(fine.mean() / once.mean() - 1.0) < 0.02


@pytest.mark.slow
def test_contents_take_indirect_light(rng: np.random.Generator) -> None:
    """A pool's bed and a particle glow as the wall does; liquid dims the bed's indirect light."""
    model, camera = _folds(rng)
    organ, place = model.organ, np.array([0.0, 0.0, 0.06])
    one = np.ones(1)
    particle = Spheres(
        place[None], 2e-3 * one, np.array([WHITE], np.uint8), np.array([9], np.uint16),
        np.full((1, 3), 0.5), 0.1 * one,
    )  # fmt: skip
    pools = Pools(
        np.array([0.2]), np.ones(len(organ.vertices), np.uint16), np.array([[0.0, 1.0]]), one
    )
    clear = Liquid(absorption=(5.0, 10.0, 15.0), scattering=(0.0, 0.0, 0.0))
    dry = LumenContents(Contents(1), particle)
    wet = LumenContents(Contents(liquid=clear), particle, pools)
    indirect = []
    for lumen_contents in (dry, wet):
        state = replace(looking(PLACE, (0.0, 0.1, 1.0)), lumen_contents=lumen_contents)
        direct, radiosity = (
            _radiance(model, camera, state, light=x) for x in ("direct", "radiosity")
        )
        assert (radiosity >= direct).all()
        indirect.append(radiosity - direct)
    state = replace(looking(PLACE, (0.0, 0.1, 1.0)), lumen_contents=dry)
    instance = Renderer(model, DIRECT).render(state, camera, channels=("instance",)).instance
    assert instance is not None
    assert (instance == 9).any()
    assert (indirect[0][instance == 9] > 0.0).all()
    assert (indirect[1] < indirect[0]).all()
