"""Path tracing is right: a hollow sphere in closed form, and Mitsuba 3 beside folds."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.support import twin_shade
from tests.support.oracle_mitsuba import path_light
from tests.support.shapes import looking, make_camera, make_model, patterned, pinhole, sphere, tube
from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.camera.lens import LensEquidistant
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import rotate_vectors
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

LOOKS = {
    "white": {"albedo": 255, "roughness": 128, "ior": 1.0, "clearcoat": 0.0},
    "dull": {"albedo": 150, "roughness": 230, "ior": 1.0, "clearcoat": 0.0},
    "wet": {"albedo": 180, "roughness": 128, "ior": 1.4, "clearcoat": 0.8},
}


TEXEL_STEPS = 2047
"""Number of steps of the square root of a color in a texel."""


def _look(albedo: int, roughness: int, ior: float, clearcoat: float) -> Appearance:
    color = np.full((1, 1, 3), albedo, np.uint8)
    rough = np.full((1, 1), roughness, np.uint8)
    return Appearance(
        color, rough, np.zeros((1, 1)), ior=ior, clearcoat=clearcoat, clearcoat_gloss=0.2
    )


def _radiance(model: Model, camera: Camera, state: State, **settings: int) -> np.ndarray:
    renderer = Renderer(model, RenderSettings(light="path", **settings))
    radiance = renderer.render(state, camera, channels=("radiance",)).radiance
    assert radiance is not None
    return radiance.astype(float)


def _sphere_radiance(look: Appearance, cos_view: np.ndarray, depth: int) -> np.ndarray:
    """Radiance of a hollow sphere under unit irradiance from its center, by angle of view.

    Light that leaves at an angle θ arrives at the same angle anywhere else, so that
    L₁(θ) = f(θ, 0) and Lₙ₊₁(θ) = ∫ f(θ, ω) Lₙ(θ_ω) cos θ_ω dω: an integral in one variable.

    Returns:
        The sum of the first `depth` reflections for each cosine.
    """
    nodes, weights = np.polynomial.legendre.leggauss(120)
    mu, weight = 0.5 * (nodes + 1.0), 0.5 * weights
    angle = np.pi * (np.arange(128) + 0.5) / 128  # the other half turn is its mirror image
    cosine, turn = (a.ravel() for a in np.meshgrid(mu, angle, indexing="ij"))
    ring = np.sqrt(1.0 - cosine**2)
    light = np.stack([ring * np.cos(turn), ring * np.sin(turn), cosine], axis=1)
    albedo = ((look.albedo[0, 0, :1] / 255 + 0.055) / 1.055) ** 2.4
    albedo = (np.rint(np.sqrt(albedo) * TEXEL_STEPS) / TEXEL_STEPS) ** 2

    def reflected(view: float, ways: np.ndarray) -> np.ndarray:
        count = len(ways)
        views = np.broadcast_to([np.sqrt(1.0 - view**2), 0.0, view], (count, 3))
        normal = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
        rough = np.full(count, look.roughness[0, 0] / 255)
        color = np.broadcast_to(albedo, (count, 1))
        return twin_shade.principled(look, color, rough, normal, views, ways)[:, 0]

    step = np.stack([reflected(m, light).reshape(120, 128).mean(axis=1) for m in mu])
    step = 2.0 * np.pi * step * weight
    straight = np.array([[0.0, 0.0, 1.0]])
    radiance = np.array([reflected(m, straight)[0] for m in mu])
    total = radiance.copy()
    for _ in range(depth - 1):
        radiance = step @ radiance
        total += radiance
    return np.interp(cos_view, mu, total)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [pytest.param(2, marks=pytest.mark.validation), 8])
@pytest.mark.parametrize("name", list(LOOKS))
def test_hollow_sphere(name: str, depth: int) -> None:
    """Partial sums of the integrating sphere to 0.1 %, whatever the wall reflects like."""
    look = _look(**LOOKS[name])
    radius, eye = 0.02, np.array([0.006, -0.004, 0.003])
    camera = make_camera((LensEquidistant(10.0, 15.5, 15.5), 32, 32), leds=())
    state = looking(tuple(eye), (0.1, 0.2, 1.0))
    pose = state.T_world_capsule
    led = Led(tuple(rotate_vectors(pose.T, -eye)), lobe_exponent=0.0, intensity=(1e-3,) * 3)
    camera = replace(camera, leds=(led,))
    model = make_model(sphere(5, radius=radius, appearance=look), camera)
    samples = 192 if name == "wet" else 64
    images = [
        _radiance(model, camera, state, spp=samples, max_bounces=depth, path_seed=seed)[..., 0]
        for seed in range(4)  # one image's pixels share light paths
    ]
    found = np.stack(images)
    rays = rotate_vectors(pose, camera_rays(camera).astype(float))
    along = rays @ eye
    reach = -along + np.sqrt(along**2 + radius**2 - eye @ eye)
    place = eye + reach[..., None] * rays
    cos_view = np.sum(rays * place, axis=-1) / radius
    expected = 1e-3 / radius**2 * _sphere_radiance(look, cos_view, depth)
    np.testing.assert_allclose(found.mean(), expected.mean(), rtol=1e-3)


@pytest.mark.slow
def test_radiance_agrees_with_mitsuba(rng: np.random.Generator) -> None:
    """Beside ring folds, wet and patterned: no block of pixels differs by more than noise does."""
    depth = 4
    look = replace(patterned(rng), clearcoat_gloss=0.0)
    organ = tube(120, 320, length=0.15, folds=0.35, capped=True, appearance=look)
    leds = tuple(
        Led((0.003 * np.cos(a), 0.003 * np.sin(a), -0.001), lobe_exponent=0.0)
        for a in (0.0, 2.0, 4.0)
    )
    camera = make_camera(pinhole(24, 1.8), leds=leds)
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.04))
    direct = RenderSettings(light="direct", shadows=True)
    straight = Renderer(model, direct).render(state, camera, channels=("radiance",)).radiance
    theirs = _blocks(path_light(model, camera, state, max_bounces=depth, spp=96))
    ours = _blocks(_radiance(model, camera, state, spp=2048, max_bounces=depth)[None])[0]
    assert _blocks(straight[None]).sum() < 0.95 * ours.sum()
    error = theirs.std(axis=0, ddof=1) / np.sqrt(len(theirs))
    z = (ours - theirs.mean(axis=0)) / error
    assert np.abs(z).max() < 4.5
    assert np.mean(z**2) < 2.0


def _blocks(images: np.ndarray) -> np.ndarray:
    """Means over blocks of 6 × 6 pixels and over colors [n 16]."""
    count, height, width, _ = images.shape
    cut = images.reshape(count, height // 6, 6, width // 6, 6, 3)
    return cut.mean(axis=(2, 4, 5)).reshape(count, -1).astype(float)


@pytest.fixture
def folded(rng: np.random.Generator) -> tuple[Model, Camera, State]:
    """A tube with ring folds, wet and patterned, and a camera of odd size in it."""
    organ = tube(40, 80, folds=0.35, capped=True, appearance=patterned(rng, relief=2e-4))
    camera = make_camera("scaramuzza")
    return make_model(organ, camera), camera, looking((0.004, -0.003, 0.05))


def test_one_reflection_is_direct_light_with_shadows(folded: tuple[Model, Camera, State]) -> None:
    model, camera, state = folded
    settings = RenderSettings(light="direct", shadows=True)
    direct = Renderer(model, settings).render(state, camera, channels=("radiance",)).radiance
    np.testing.assert_array_equal(_radiance(*folded, spp=4, max_bounces=1), direct)
    assert (_radiance(*folded, spp=4, max_bounces=2) >= direct).all()
    dark = replace(camera, leds=())
    assert not _radiance(model, dark, state, spp=4, max_bounces=3).any()


def test_labels_do_not_depend_on_light(folded: tuple[Model, Camera, State]) -> None:
    model, camera, state = folded
    names = ("depth", "normal", "label", "instance", "albedo", "position")
    for light in ("direct", "path"):
        settings = RenderSettings(light=light, spp=1)
        frame = Renderer(model, settings).render(state, camera, channels=(*names, "rgb"))
        bare = Renderer(model, settings).render(state, camera, channels=names)
        for name in names:
            np.testing.assert_array_equal(getattr(frame, name), getattr(bare, name))


def test_seed_time_and_view_choose_the_paths(folded: tuple[Model, Camera, State]) -> None:
    model, camera, state = folded
    first = _radiance(*folded, spp=2)
    np.testing.assert_array_equal(first, _radiance(*folded, spp=2))
    others = [
        _radiance(*folded, spp=2, path_seed=1),
        _radiance(model, camera, replace(state, time=0.1), spp=2),
    ]
    for other in others:
        assert np.mean(other != first) > 0.5
        np.testing.assert_allclose(other.mean(), first.mean(), rtol=0.05)


@pytest.mark.slow
def test_noise_falls_with_samples(folded: tuple[Model, Camera, State]) -> None:
    """At least as 1/√n; even sampling makes it fall faster."""
    model, _, state = folded
    small = make_camera(pinhole(32, 1.8))
    exact = _radiance(model, small, state, spp=1024, path_seed=9)
    images = [_radiance(model, small, state, spp=n) for n in (4, 16, 64)]
    errors = [np.sqrt(np.mean((image - exact) ** 2)) for image in images]
    assert all(later < 0.6 * earlier for earlier, later in pairwise(errors))


@pytest.mark.slow
def test_rays_within_a_pixel_share_its_paths(folded: tuple[Model, Camera, State]) -> None:
    one = _radiance(*folded, spp=64)
    four = _radiance(*folded, spp=16, supersampling=2)
    np.testing.assert_allclose(four.mean(), one.mean(), rtol=0.03)


def test_harsh_input_gives_finite_light(rng: np.random.Generator) -> None:
    """Cliffs for relief, faces without area or texture, lamps on the wall and at the lens."""
    organ = tube(40, 80, folds=0.4, capped=True, appearance=patterned(rng, relief=5e-3))
    organ.faces[::9, 1] = organ.faces[::9, 0]
    organ.uv[::4] = 0.0
    state = looking((0.004, -0.003, 0.05))
    pose = state.T_world_capsule
    on_wall = rotate_vectors(pose.T, organ.vertices[1200:1202] - pose[:3, 3])
    leds = tuple(Led(tuple(place), lobe_exponent=2.0) for place in (*on_wall, np.zeros(3)))
    camera = make_camera("equidistant", leds=leds)
    radiance = _radiance(make_model(organ, camera), camera, state, spp=8, max_bounces=9)
    assert np.isfinite(radiance).all()
    assert (radiance >= 0.0).all()


def test_wrong_settings() -> None:
    with pytest.raises(UnknownNameError, match=r"No light named 'sun'\. Known: direct, path"):
        RenderSettings(light="sun")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"spp is 0\. Allowed: 1 to 2147483648"):
        RenderSettings(light="direct", spp=0)
    with pytest.raises(InputError, match=r"max_bounces is 101\. Allowed: 1 to 100"):
        RenderSettings(light="direct", max_bounces=101)
    with pytest.raises(InputError, match=r"path_seed is -1\. Allowed: 0 to 18446744073709551615"):
        RenderSettings(light="direct", path_seed=-1)
