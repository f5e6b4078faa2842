"""The compiled renderer agrees with its readable twin on small scenes, channel by channel."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support import twin_shade
from tests.support.shapes import (
    DIRECT,
    LENSES,
    looking,
    make_camera,
    make_model,
    patterned,
    pinhole,
    sphere,
    tube,
)
from vrcaps.camera.camera import Led
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings

LEDS = (
    Led((0.003, 0.001, -0.001), (0.0, 0.0, 1.0), (2e-3, 1e-3, 3e-3), 1.0),
    Led((-0.002, 0.002, 0.0), (0.0, 0.6, 0.8), (1e-3, 2e-3, 1e-3), 2.5),
    Led((0.0, -0.003, 0.001), (0.0, 0.0, 1.0), (1e-3, 1e-3, 1e-3), 0.0),
)


def _close(ours: np.ndarray, twins: np.ndarray, atol: float, share: float = 0.998) -> None:
    """All but a few pixels, on edges of triangles and shadows, agree."""
    ours, twins = (np.atleast_3d(x).reshape(*x.shape[:2], -1) for x in (ours, twins))
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(twins))
    good = np.all(np.isnan(twins) | (np.abs(ours.astype(float) - twins) <= atol), axis=2)
    assert good.mean() >= share, f"{good.mean():.5f} of the pixels are within {atol}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shadows", "lens"), [*((False, lens) for lens in LENSES), (True, "pinhole")]
)
def test_every_channel_agrees(rng: np.random.Generator, lens: str, shadows: bool) -> None:
    look = patterned(rng, relief=3e-4)
    organ = tube(20, 21, length=0.1, folds=0.35, capped=True, appearance=look)
    camera = make_camera(lens, leds=LEDS)
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.025))
    expected = twin_shade.render(model, camera, state, shadows=shadows)
    settings = RenderSettings(light="direct", shadows=shadows)
    names = tuple(name for name in expected if name != "face")
    frame = Renderer(model, settings).render(state, camera, channels=names)
    for name in ("depth", "ray_distance", "position", "arc_length"):
        _close(getattr(frame, name), expected[name], 1e-7)
    _close(frame.normal, expected["normal"], 2e-5)
    _close(frame.label, expected["label"], 0)
    _close(frame.instance, expected["instance"], 0)
    _close(frame.albedo, expected["albedo"], 1.5e-3, 0.99)
    bright = expected["radiance"].max()
    _close(frame.radiance / bright, expected["radiance"] / bright, 2e-3, 0.99)


def test_labels_agree_from_outside_and_through_open_ends(rng: np.random.Generator) -> None:
    """Back sides are seen too, their normals turned to the camera."""
    organ = tube(20, 11, length=0.05, appearance=patterned(rng))
    camera = make_camera("pinhole", leds=LEDS)
    model, state = make_model(organ, camera), looking((0.08, 0.01, 0.02), (-1.0, 0.05, 0.03))
    expected = twin_shade.render(model, camera, state)
    frame = Renderer(model, DIRECT).render(state, camera, channels=("depth", "normal", "label"))
    assert 0.2 < np.isnan(frame.depth).mean() < 0.9
    _close(frame.depth, expected["depth"], 3e-8)
    _close(frame.normal, expected["normal"], 2e-5)
    _close(frame.label, expected["label"], 0)


def test_moved_wall_agrees(rng: np.random.Generator) -> None:
    organ = sphere(2, appearance=patterned(rng))
    moved = organ.vertices * [1.3, 0.8, 1.1] + [0.01, 0.0, -0.02]
    camera = make_camera("equidistant", leds=LEDS)
    model = make_model(organ, camera)
    state = looking((0.012, 0.001, -0.018), vertices_world=moved)
    expected = twin_shade.render(model, camera, state)
    names = ("depth", "normal", "radiance", "face")
    frame = Renderer(model, DIRECT).render(state, camera, channels=names[:3])
    _close(frame.depth, expected["depth"], 2e-8)
    _close(frame.normal, expected["normal"], 2e-5)
    bright = expected["radiance"].max()
    _close(frame.radiance / bright, expected["radiance"] / bright, 2e-3, 0.99)


def test_fine_textures_are_averaged_over_a_pixel(rng: np.random.Generator) -> None:
    """Far walls take coarser mip levels, as the twin does."""
    look = patterned(rng, size=(130, 258))
    organ = tube(24, 21, length=0.2, capped=True, appearance=look)
    camera = make_camera("pinhole", leds=LEDS)
    model, state = make_model(organ, camera), looking((0.0, 0.002, 0.01), (0.02, 0.01, 1.0))
    expected = twin_shade.render(model, camera, state)["albedo"]
    albedo = Renderer(model, DIRECT).render(state, camera, channels=("albedo",)).albedo
    # A level that is taken one step off at its limit is rare and still alike.
    _close(albedo, expected, 2e-3, 0.97)
    assert np.nanmean(np.abs(albedo - expected)) < 1e-3


def test_pulled_walls_show_a_coarser_texture_instead_of_streaks(rng: np.random.Generator) -> None:
    """Contrast across a wall falls where it is pulled along, and stays where it grows alike."""
    length = 2.0 * np.pi * 0.02
    organ = tube(40, 41, length=length, appearance=patterned(rng, size=(81, 256)))
    camera = make_camera(pinhole(40), leds=LEDS)
    model = make_model(organ, camera)
    renderer = Renderer(model, DIRECT)

    def contrast(growth: tuple[float, float, float]) -> float:
        moved = organ.vertices * growth
        state = looking((0.0, 0.0, 0.5 * growth[2] * length), (1.0, 0.0, 0.0), vertices_world=moved)
        albedo = renderer.render(state, camera, channels=("albedo",)).albedo
        _close(albedo, twin_shade.render(model, camera, state)["albedo"], 2e-3, 0.97)
        return float(albedo.std())

    whole = contrast((1.0, 1.0, 1.0))
    assert contrast((1.0, 1.0, 1.5)) > 0.8 * whole
    assert contrast((1.0, 1.0, 8.0)) < 0.4 * whole
