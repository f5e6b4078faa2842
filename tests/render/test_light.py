"""Light is right: laws in closed form, and Mitsuba 3 with the same mesh, texture and lights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.oracle_mitsuba import direct_light
from tests.support.shapes import (
    DIRECT,
    LENSES,
    looking,
    make_camera,
    make_model,
    make_organ,
    patterned,
    pinhole,
    sphere,
    tube,
)
from tests.support.twin import unit
from vrcaps import _core
from vrcaps.camera.camera import Led, camera_rays
from vrcaps.camera.lens import LensEquidistant
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import rotate_vectors
from vrcaps.organ.surface import Appearance, OrganSurface, clearcoat_alpha
from vrcaps.render.channels import Frame
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings

RADIANCE = ("radiance",)


def _plain(albedo: int = 255, roughness: int = 128, *, ior: float = 1.0, clearcoat: float = 0.0):
    """One color everywhere; index 1 and no coat leave only the diffuse base."""
    shape = (1, 1)
    return Appearance(
        np.full((*shape, 3), albedo, np.uint8),
        np.full(shape, roughness, np.uint8),
        np.zeros(shape),
        ior=ior,
        clearcoat=clearcoat,
    )


def _floor(appearance: Appearance, *, size: float = 0.1, cells: int = 1) -> OrganSurface:
    """A square in the plane z = 0, seen from above; u is along x, v along y."""
    steps = size * (np.arange(cells + 1) / cells - 0.5)
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    vertices = np.stack([x, y, np.zeros_like(x)], axis=1)
    row, column = (a.ravel() for a in np.mgrid[:cells, :cells])
    a = row * (cells + 1) + column
    b, c, d = a + 1, a + cells + 1, a + cells + 2
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    uv = (vertices[:, :2] / size + 0.5)[faces]
    return make_organ(vertices, faces, uv=uv, appearance=appearance)


@pytest.mark.slow
@pytest.mark.parametrize("shadows", [False, True])
@pytest.mark.parametrize("wet", [False, True])
@pytest.mark.parametrize("lobe", [0.0, 1.0])
def test_radiance_agrees_with_mitsuba(
    rng: np.random.Generator, lobe: float, wet: bool, shadows: bool
) -> None:
    """Without shadows inside a sphere, where there are none; with them behind ring folds."""
    look = replace(patterned(rng), ior=1.4 if wet else 1.0001, clearcoat=0.7 if wet else 0.0)
    angles = (0.0, 2.0, 4.0)
    leds = tuple(
        Led(
            (0.003 * np.cos(a), 0.003 * np.sin(a), -0.001),
            (0.0, 0.0, 1.0),
            (2e-3, 1e-3, 3e-3),
            lobe,
        )
        for a in angles
    )
    if shadows:
        organ = tube(60, 160, length=0.15, folds=0.35, capped=True, appearance=look)
    else:
        organ = sphere(4, appearance=look)
    camera = make_camera(pinhole(48, 1.8), leds=leds)
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.04 if shadows else 0.003))
    theirs = direct_light(model, camera, state)
    ours = Renderer(model, RenderSettings(light="direct", shadows=shadows)).render(
        state, camera, channels=RADIANCE
    )
    assert np.sqrt(np.mean((ours.radiance - theirs) ** 2)) < 3e-3 * theirs.mean()
    lit = theirs.max(axis=-1) > 0.01 * theirs.max()
    relative = np.abs(ours.radiance[lit].max(axis=-1) / theirs[lit].max(axis=-1) - 1.0)
    assert np.mean(relative < 0.01) > 0.998  # all but a few pixels on edges of shadows
    dark = (theirs.max(axis=-1) == 0.0) & (ours.radiance.max(axis=-1) > 0.0)
    assert dark.mean() < 0.005  # outlines, where Mitsuba leaves normals that face away


def test_light_falls_with_the_inverse_square(rng: np.random.Generator) -> None:
    look, camera = (
        _plain(),
        make_camera(pinhole(16), leds=(Led((0.0, 0.0, 0.0), lobe_exponent=0.0),)),
    )
    near, far = (
        Renderer(make_model(sphere(5, radius=radius, appearance=look), camera), DIRECT)
        .render(looking((0.0, 0.0, 0.0)), camera, channels=RADIANCE)
        .radiance
        for radius in (0.01, 0.03)
    )
    np.testing.assert_allclose(near, 9.0 * far, rtol=1e-4)
    # At the center light, view and normal agree: albedo/π · I/r², for albedo 1.
    np.testing.assert_allclose(near, 1e-3 / (np.pi * 0.01**2), rtol=3e-3)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, 3.7])
def test_lobe_of_an_led(exponent: float) -> None:
    """Seen from the middle of a sphere the image shows the lobe: cos(φ)^m."""
    axis = unit(np.array([0.3, -0.2, 1.0]))
    led = Led((0.0, 0.0, 0.0), tuple(axis), (1e-3, 2e-3, 3e-3), exponent)
    camera = make_camera((LensEquidistant(20.0, 31.5, 31.5), 64, 64), leds=(led,))
    model = make_model(sphere(5, appearance=_plain()), camera)
    image = (
        Renderer(model, DIRECT).render(looking((0.0, 0.0, 0.0)), camera, channels=RADIANCE).radiance
    )
    cosine = np.clip(camera_rays(camera) @ axis, 0.0, 1.0)
    expected = np.where(cosine > 0.0, cosine**exponent, exponent == 0.0)[..., None]
    expected = expected * np.array([1.0, 2.0, 3.0]) * 1e-3 / (np.pi * 0.02**2)
    np.testing.assert_allclose(image, expected, atol=5e-3 * expected.max())


@pytest.mark.parametrize("roughness", [0, 128, 255])
def test_diffuse_base_of_a_plane(roughness: int) -> None:
    """Burley 2012, 5.3, for light and view at the same angle θ.

    The base is albedo/π (1 + (F − 1)(1 − cos θ)⁵)² with F = ½ + 2 roughness, times I cos θ/d².
    """
    led = Led((0.0, 0.0, 0.0), lobe_exponent=0.0)
    camera = make_camera(pinhole(40, 2.6), leds=(led,))
    model = make_model(_floor(_plain(188, roughness), size=10.0), camera)
    frame = Renderer(model, DIRECT).render(
        looking((0.0, 0.0, 0.01), (0.01, 0.02, -1.0)), camera, channels=("radiance", "ray_distance")
    )
    distance = frame.ray_distance.astype(float)
    cosine = 0.01 / distance
    at_90 = 0.5 + 2.0 * roughness / 255.0
    base = (1.0 + (at_90 - 1.0) * (1.0 - cosine) ** 5) ** 2
    albedo = ((188 / 255 + 0.055) / 1.055) ** 2.4
    expected = albedo / np.pi * base * 1e-3 * cosine / distance**2
    np.testing.assert_allclose(frame.radiance[..., 0], expected, rtol=2e-3)


def test_highlight_of_the_base_facing_the_light() -> None:
    """Fresnel ((n−1)/(n+1))², GGX density 1/(π α²), over 4 (Walter et al. 2007, eq. 20)."""
    led = Led((0.0, 0.0, 0.0), lobe_exponent=0.0)
    camera = make_camera(pinhole(1), leds=(led,))
    look = _plain(0, 128, ior=1.4)
    state = looking((0.0, 0.0, 0.01), (0.0, 0.0, -1.0))
    image = Renderer(make_model(_floor(look), camera), DIRECT).render(
        state, camera, channels=RADIANCE
    )
    alpha = (128 / 255) ** 2
    expected = (0.4 / 2.4) ** 2 / (4.0 * np.pi * alpha**2) * 1e-3 / 0.01**2
    np.testing.assert_allclose(image.radiance[0, 0], expected, rtol=1e-4)


def test_highlight_of_the_coat_facing_the_light() -> None:
    """A quarter of 0.04 times the GTR1 density (a² − 1)/(π ln a²) / a² (Burley 2012, 5.4)."""
    led = Led((0.0, 0.0, 0.0), lobe_exponent=0.0)
    camera = make_camera(pinhole(1), leds=(led,))
    look = replace(_plain(0, 128, clearcoat=0.8), clearcoat_gloss=0.6)
    state = looking((0.0, 0.0, 0.01), (0.0, 0.0, -1.0))
    image = Renderer(make_model(_floor(look), camera), DIRECT).render(
        state, camera, channels=RADIANCE
    )
    square = clearcoat_alpha(0.6) ** 2
    density = (square - 1.0) / (np.pi * np.log(square)) / square
    expected = 0.8 * 0.25 * 0.04 * density * 1e-3 / 0.01**2
    np.testing.assert_allclose(image.radiance[0, 0], expected, rtol=1e-3)


@pytest.mark.parametrize("slant", [0.0, 0.6, 1.1])
def test_the_wall_reflects_no_more_light_than_it_gets(slant: float) -> None:
    """∫ f cos θ dω over the hemisphere of light; Burley's base itself may gain a little."""
    height, far, count = 1.0, 400.0, 3000
    k = np.arange(count) + 0.5
    z, angle = k / count, np.pi * (1.0 + np.sqrt(5.0)) * k  # equal areas of the hemisphere
    ring = np.sqrt(1.0 - z * z)
    way = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    state = looking((height * np.tan(slant), 0.0, height), (-np.tan(slant), 0.0, -1.0))
    pose = state.T_world_capsule
    places = far * way - pose[:3, 3]
    leds = tuple(Led(tuple(p), lobe_exponent=0.0) for p in rotate_vectors(pose.T, places))
    camera = make_camera(pinhole(1), leds=leds)
    for roughness in (77, 128, 255):
        look = _plain(255, roughness, ior=1.4, clearcoat=1.0)
        model = make_model(_floor(look, size=1000.0), camera)
        image = Renderer(model, DIRECT).render(state, camera, channels=RADIANCE).radiance
        reflected = image[0, 0, 0] / 1e-3 * far**2 * 2.0 * np.pi / count
        assert 0.75 < reflected < 1.25


@pytest.mark.slow
@pytest.mark.parametrize("along", ["u", "v"])
def test_relief_looks_like_a_wall_of_that_shape(along: str) -> None:
    """A relief texture darkens and brightens as a really displaced wall does."""
    size, waves, depth = 0.02, 10, 10e-6
    cells = 300
    steps = (np.arange(cells) + 0.5) / cells
    wave = depth * np.sin(2.0 * np.pi * waves * steps)
    height = (
        np.broadcast_to(wave, (cells, cells))
        if along == "u"
        else wave[::-1, None] + np.zeros((1, cells))
    )
    flat = replace(_plain(200, 200), height=np.zeros((cells, cells)))
    flat = replace(
        flat,
        albedo=np.full((cells, cells, 3), 200, np.uint8),
        roughness=np.full((cells, cells), 200, np.uint8),
    )
    floor = _floor(flat, size=size, cells=cells)
    axis = 0 if along == "u" else 1
    lifted = floor.vertices.copy()
    lifted[:, 2] = depth * np.sin(2.0 * np.pi * waves * (lifted[:, axis] / size + 0.5))
    led = Led((0.006, 0.006, -0.002), lobe_exponent=0.0)
    camera = make_camera(pinhole(64, 0.9), leds=(led,))
    state = looking((0.0, 0.0, 0.008), (0.02, 0.01, -1.0))
    plain, shaped, drawn = (
        Renderer(make_model(organ, camera), DIRECT)
        .render(state, camera, channels=RADIANCE)
        .radiance[..., 0]
        for organ in (
            floor,
            make_organ(lifted, floor.faces, uv=floor.uv, appearance=flat),
            replace(floor, appearance=replace(flat, height=height)),
        )
    )
    effect, error = shaped / plain - 1.0, drawn / shaped - 1.0
    assert np.abs(effect).max() > 0.02
    # What is left: crests are also nearer to the light.
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(effect**2))


def test_srgb_follows_its_formula() -> None:
    """IEC 61966-2-1, rounded to nearest; out of range is clipped."""
    radiance = np.linspace(-0.2, 2.4, 60_000, dtype=np.float32).reshape(100, 200, 3)
    encoded = _core.encode_srgb(radiance, 0.5)
    x = np.clip(0.5 * radiance.astype(float), 0.0, 1.0)
    exact = 255.0 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    assert encoded.dtype == np.uint8
    assert np.abs(encoded - exact).max() < 0.5 + 1e-3


def test_rgb_is_the_encoded_radiance(rng: np.random.Generator) -> None:
    organ = sphere(3, appearance=patterned(rng))
    for exposure in (0.01, 0.5):
        camera = make_camera("scaramuzza", exposure=exposure, image_circle_px=35.0)
        model, state = make_model(organ, camera), looking((0.004, -0.006, 0.003))
        frame = Renderer(model, DIRECT).render(state, camera, channels=("rgb", "radiance", "depth"))
        np.testing.assert_array_equal(frame.rgb, _core.encode_srgb(frame.radiance, exposure))
        assert not frame.rgb[np.isnan(frame.depth)].any()
        assert frame.rgb[np.isfinite(frame.depth)].any(axis=-1).mean() > 0.9


def test_supersampling_is_the_mean_of_a_finer_image(rng: np.random.Generator) -> None:
    organ = tube(40, 40, folds=0.3, capped=True, appearance=patterned(rng))
    coarse, fine = make_camera(pinhole(40)), make_camera(pinhole(120))
    model, state = make_model(organ), looking((0.004, -0.003, 0.04))
    names = ("radiance", "rgb", "depth", "label", "albedo")
    frame = Renderer(model, RenderSettings(light="direct", shadows=False, supersampling=3)).render(
        state, coarse, channels=names
    )
    image = Renderer(model, DIRECT).render(state, fine, channels=RADIANCE).radiance
    mean = image.reshape(40, 3, 40, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(frame.radiance, mean, rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(frame.rgb, _core.encode_srgb(frame.radiance, coarse.exposure))
    single = Renderer(model, DIRECT).render(state, coarse, channels=names)
    for name in ("depth", "label", "albedo"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(single, name))


def test_light_of_leds_adds_up(rng: np.random.Generator) -> None:
    organ = sphere(3, appearance=patterned(rng))
    leds = (Led((0.003, 0.0, 0.0)), Led((0.0, 0.003, 0.0), intensity=(2e-3, 1e-3, 0.0)))
    model, state = make_model(organ), looking((0.004, -0.006, 0.003))
    images = [
        Renderer(model, DIRECT).render(state, make_camera(leds=some), channels=RADIANCE).radiance
        for some in (leds, leds[:1], leds[1:], ())
    ]
    np.testing.assert_allclose(images[0], images[1] + images[2], rtol=1e-5)
    assert not images[3].any()


def test_shadows_only_darken(rng: np.random.Generator) -> None:
    organ = tube(40, 80, folds=0.4, capped=True, appearance=patterned(rng))
    camera = make_camera(leds=(Led((0.004, 0.0, -0.006)),))
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.05))
    free, shaded = (
        Renderer(model, RenderSettings(light="direct", shadows=on))
        .render(state, camera, channels=RADIANCE)
        .radiance
        for on in (False, True)
    )
    assert (shaded <= free).all()
    dark = (shaded.max(axis=-1) == 0.0) & (free.max(axis=-1) > 0.0)
    assert 0.02 < dark.mean() < 0.9
    np.testing.assert_array_equal(shaded[~dark], free[~dark])


def test_harsh_input_gives_finite_light(rng: np.random.Generator) -> None:
    """Cliffs for relief, faces without area or texture, lamps on the wall and at the lens."""
    organ = tube(40, 80, folds=0.4, capped=True, appearance=patterned(rng, relief=5e-3))
    vertices = np.concatenate([organ.vertices, [[0.0, 0.0, 9.0]]])  # one that no face uses
    faces, uv = organ.faces.copy(), organ.uv.copy()
    faces[::9, 1] = faces[::9, 0]
    uv[::4] = 0.0
    harsh = make_organ(vertices, faces, uv=uv, appearance=organ.appearance)
    state = looking((0.004, -0.003, 0.05))
    pose = state.T_world_capsule
    on_wall = rotate_vectors(pose.T, organ.vertices[1200:1202] - pose[:3, 3])
    leds = tuple(Led(tuple(place), lobe_exponent=2.0) for place in (*on_wall, np.zeros(3)))
    camera = make_camera("equidistant", leds=leds)
    for shadows in (False, True):
        settings = RenderSettings(light="direct", shadows=shadows)
        frame = Renderer(make_model(harsh, camera), settings).render(
            state, camera, channels=("radiance", "normal", "depth", "albedo")
        )
        seen = np.isfinite(frame.depth)
        assert seen.mean() > 0.6
        assert np.isfinite(frame.radiance).all()
        assert (frame.radiance >= 0.0).all()
        assert np.isfinite(frame.albedo[seen]).all()
        np.testing.assert_allclose(np.linalg.norm(frame.normal[seen], axis=1), 1.0, atol=1e-5)


def test_an_organ_without_textures_is_drawn_plain() -> None:
    camera = make_camera()
    model, state = make_model(sphere(3), camera), looking((0.004, -0.006, 0.003))
    frame = Renderer(model, DIRECT).render(state, camera, channels=("rgb", "albedo"))
    assert np.ptp(frame.albedo.reshape(-1, 3), axis=0).max() == 0.0
    assert frame.rgb.any()


def test_arrays_of_an_earlier_frame_are_used_again() -> None:
    camera = make_camera()
    renderer = Renderer(make_model(sphere(3), camera), DIRECT)
    first = renderer.render(looking((0.004, -0.006, 0.003)), camera)
    again = renderer.render(looking((0.0, 0.0, 0.003)), camera, out=first)
    assert again.depth is first.depth
    assert again.rgb is first.rgb
    other = make_camera("equidistant")
    assert renderer.render(looking((0.0, 0.0, 0.003)), other, out=first).depth is not first.depth
    first.rgb.flags.writeable = False
    assert renderer.render(looking((0.0, 0.0, 0.003)), camera, out=first).rgb is not first.rgb
    fresh = renderer.render(looking((0.0, 0.0, 0.003)), camera, out=Frame())
    np.testing.assert_array_equal(fresh.depth, again.depth)


@pytest.mark.parametrize("lens", LENSES)
def test_image_circle_is_dark_outside(lens: str) -> None:
    camera = make_camera(lens, image_circle_px=25.0)
    frame = Renderer(make_model(sphere(3), camera), DIRECT).render(
        looking((0.0, 0.001, 0.003)), camera
    )
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    inside = np.hypot(columns - camera.lens.cx, rows - camera.lens.cy) <= 25.0
    np.testing.assert_array_equal(np.isfinite(frame.depth), inside)
    np.testing.assert_array_equal(frame.label > 0, inside)


def test_wrong_settings_and_names() -> None:
    for factor in (0, 17):
        with pytest.raises(InputError, match=rf"supersampling is {factor}\. Allowed: 1 to 16"):
            RenderSettings(light="direct", supersampling=factor)
    camera = make_camera()
    renderer = Renderer(make_model(sphere(1), camera), DIRECT)
    with pytest.raises(
        UnknownNameError, match=r"No channel named 'dpeth'\. Known: albedo, arc_length"
    ):
        renderer.render(looking((0.0, 0.0, 0.0)), camera, channels=("dpeth",))


def test_no_face_that_is_seen_and_lit_is_black() -> None:
    """Folds of few faces, the lamp at the eye: where smooth normals are edge-on, faces are not."""
    look = _plain()
    organ = tube(10, 24, length=0.1, folds=0.35, capped=True, appearance=look)
    camera = make_camera(pinhole(64, 1.8), leds=(Led((0, 0, 0), (0, 0, 1), (1e-3,) * 3, 0.0),))
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.02))
    frame = Renderer(model, DIRECT).render(state, camera, channels=("radiance", "ray_distance"))
    met = np.isfinite(frame.ray_distance)
    light = frame.radiance[met][:, 0] * frame.ray_distance[met] ** 2  # without the fall-off
    assert met.sum() > 1000
    assert light.min() > 0.05 * light.max()
