"""LEDs as discs: penumbrae, highlights and irradiance against quadrature over the disc."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import (
    looking,
    make_camera,
    make_model,
    make_organ,
    patterned,
    pinhole,
    tube,
)
from tests.support.threads import digests_by_threads
from vrcaps.camera.camera import Camera, Led, led_ring
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.units import MM
from vrcaps.organ.surface import Appearance, OrganSurface
from vrcaps.render.batch import render_batch
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

SHADED = RenderSettings(light="direct")
FREE = RenderSettings(light="direct", shadows=False)
RADIANCE = ("radiance",)
RADIUS = 0.6 * MM


def _radiance(
    model: Model, camera: Camera, state: State, settings: RenderSettings = SHADED
) -> np.ndarray:
    frame = Renderer(model, settings).render(state, camera, channels=RADIANCE)
    return np.asarray(frame.radiance, float)


def _plain(roughness: int = 255, *, ior: float = 1.0, clearcoat: float = 0.0) -> Appearance:
    return Appearance(
        np.full((1, 1, 3), 255, np.uint8),
        np.full((1, 1), roughness, np.uint8),
        np.zeros((1, 1)),
        ior=ior,
        clearcoat=clearcoat,
        clearcoat_gloss=0.6,
    )


def _floor(look: Appearance, *, blocker: float | None = None) -> OrganSurface:
    """A floor at z = 0, and at a height above it a roof over all x below 0."""
    sides = [(-0.1, 0.1, 0.0)] + ([] if blocker is None else [(-0.1, 0.0, blocker)])
    vertices = [[x, y, z] for low, high, z in sides for y in (-0.1, 0.1) for x in (low, high)]
    quad = np.array([[0, 1, 3], [0, 3, 2]])
    faces = np.concatenate([quad + 4 * k for k in range(len(sides))])
    return make_organ(np.array(vertices), faces, appearance=look)


def _disc(count: int, radius: float) -> np.ndarray:
    """Points [n 2] evenly over a disc: a spiral (Vogel 1979)."""
    k = np.arange(count) + 0.5
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    return radius * np.sqrt(k / count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)


def _as_points(led: Led, count: int) -> tuple[Led, ...]:
    """Points evenly over the disc of an LED."""
    axis = np.array(led.direction_camera)
    right = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    right /= np.linalg.norm(right)
    offsets = _disc(count, led.emitter_radius) @ np.stack([right, np.cross(axis, right)])
    intensity = tuple((np.array(led.intensity) / count).tolist())
    return tuple(
        replace(led, position_camera=tuple(place), intensity=intensity, emitter_radius=0.0)
        for place in (led.position_camera + offsets).tolist()
    )


def _ring(radius: float = RADIUS) -> tuple[Led, ...]:
    return led_ring(6, 3.5 * MM, emitter_radius=radius)


def _half_plane(
    radius: float, height: float, eye: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Visible fraction of an LED above a half-plane [h w], a reference, and place on the floor.

    From the floor at x an LED at twice the blocker's height is seen where its own x is above −x:
    acos(t)/π − t √(1 − t²)/π of its area for t = −x over its radius.
    """
    led = Led((0.0, 0.0, eye - 2.0 * height), emitter_radius=radius)
    camera, state = (
        make_camera(pinhole(96, 0.9), leds=(led,)),
        looking((0.0, 0.0, eye), (0, 0, -1)),
    )
    shaded = _radiance(make_model(_floor(_plain(), blocker=height), camera), camera, state)
    model = make_model(_floor(_plain()), camera)
    free = _radiance(model, camera, state, FREE)
    frame = Renderer(model, FREE).render(state, camera, channels=("position",))
    place = np.asarray(frame.position, float)
    x = place[..., 0]
    points = _disc(4000, radius)[:, 0]
    seen = (points[None] > -x.ravel()[:, None]).mean(1).reshape(x.shape)
    t = np.clip(-x / radius, -1.0, 1.0)
    closed = (np.arccos(t) - t * np.sqrt(1.0 - t * t)) / np.pi
    assert np.abs(closed - seen).max() < 2e-3
    return (shaded / free)[..., 0], closed, place


@pytest.mark.parametrize("radius", [0.5 * MM, 1.5 * MM])
def test_penumbra_behind_a_half_plane(radius: float) -> None:
    """The visible fraction is the integral over the part of the disc beyond the blocker's edge."""
    fraction, closed, place = _half_plane(radius, 10.0 * MM, 8.0 * MM)
    x = place[..., 0]
    assert ((fraction > 0.1) & (fraction < 0.9)).mean() > 0.5 * radius / (4.0 * MM)
    # The mean is a quadrature with 16 points; at the border of an image it lacks some of them.
    error, hard = np.abs(fraction - closed), np.abs((x > 0.0) - closed)
    assert error[4:-4, 4:-4].max() < 0.16
    assert error.mean() < 0.35 * hard.mean()
    assert abs((fraction - closed).mean()) < 0.2 * error.mean() + 1e-3
    assert (fraction[x < -1.5 * radius] == 0.0).all()
    np.testing.assert_allclose(fraction[x > 1.5 * radius], 1.0, rtol=1e-5)


def test_penumbra_near_an_led() -> None:
    """At 5 radii, a pixel has the light that arrives at its own point, not a neighbors' mean."""
    height = 1.5 * MM
    fraction, closed, place = _half_plane(RADIUS, height, 1.2 * MM)
    x = place[..., 0]
    # Each point of the disc sends its radiance times the cosines at both ends over the square.
    disc = np.pad(_disc(400, RADIUS), ((0, 0), (0, 1)), constant_values=2.0 * height)
    square = ((place[..., None, :] - disc) ** 2).sum(-1)
    is_seen = disc[:, 0] > -x[..., None]
    arriving = (is_seen / square**2).sum(-1) / (1.0 / square**2).sum(-1)
    error, hard = np.abs(fraction - arriving), np.abs((x > 0.0) - arriving)
    assert (hard > 0.1).mean() > 0.3
    assert error.max() < 0.13  # steps of about 1/16
    assert error.mean() < 0.2 * hard.mean()
    assert error.mean() < 0.9 * np.abs(fraction - closed).mean()
    assert len(np.unique(np.round(fraction[48], 4))) > 17  # samples differ in weight


@pytest.mark.parametrize("height", [0.0, 0.3 * MM])
def test_a_disc_partly_below_the_horizon_is_the_sum_of_its_points(height: float) -> None:
    """An LED at a wall: the part of its disc beyond the wall neither lights nor counts."""
    state = looking((-2.0 * MM, 0.0, 3.0 * MM), (1.0, 0.0, 0.0))
    camera = make_camera(pinhole(180, 1.6))
    T_world_camera = state.T_world_capsule @ camera.T_capsule_camera
    place = np.linalg.inv(T_world_camera) @ [0.0, 0.0, height, 1.0]
    led = Led(tuple(place[:3].tolist()), emitter_radius=RADIUS)
    images = []
    for leds in ((led,), _as_points(led, 200), (replace(led, emitter_radius=0.0),)):
        model = make_model(_floor(_plain()), make_camera(pinhole(180, 1.6), leds=leds))
        images.append(_radiance(model, model.device.cameras[0], state)[..., 0])
    disc, points, point = images

    def error(image: np.ndarray) -> float:
        return float(np.sqrt(np.mean((image - points) ** 2)) / points.mean())

    assert error(disc) < 0.15 * error(point)
    assert disc.sum() == pytest.approx(points.sum(), rel=0.08)  # 8 to 16 samples are above


@pytest.mark.parametrize("distance", [3.0 * MM, 12.0 * MM])
@pytest.mark.parametrize(("look", "peak"), [
    (_plain(), 0.02),
    (_plain(60, ior=1.4), 0.06),
    (_plain(clearcoat=1.0), 0.06),
])  # fmt: skip
def test_reflection_of_a_disc_is_that_of_its_points(
    look: Appearance, peak: float, distance: float
) -> None:
    """Diffuse base, GGX and clearcoat: closed forms for the disc against the sum over points."""
    led = Led((2.5 * MM, 1.0 * MM, 0.0), emitter_radius=RADIUS)
    state = looking((0.0, 0.0, distance), (0.1, 0.0, -1.0))
    images = []
    for leds in ((led,), _as_points(led, 800), (replace(led, emitter_radius=0.0),)):
        camera = make_camera(pinhole(48, 1.6), leds=leds)
        images.append(_radiance(make_model(_floor(look), camera), camera, state, FREE)[..., 0])
    disc, points, point = images
    error = np.sqrt(np.mean((disc - points) ** 2)) / points.mean()
    assert error < 0.5 * np.sqrt(np.mean((point - points) ** 2)) / points.mean() + 1e-3
    assert np.abs(disc - points).max() < peak * points.max()
    assert disc.sum() == pytest.approx(points.sum(), rel=0.02)


@pytest.mark.parametrize("distance", [3.0 * MM, 12.0 * MM])
@pytest.mark.parametrize("gloss", [0.6, 0.93])
def test_highlight_of_a_disc_seen_at_an_angle(gloss: float, distance: float) -> None:
    """The half vectors of a tilted disc fill an ellipse, not a circle."""
    look = replace(_plain(clearcoat=1.0), clearcoat_gloss=gloss)
    led = Led((2.5 * MM, 1.0 * MM, 0.0), (np.sin(1.0), 0.0, np.cos(1.0)), emitter_radius=RADIUS)
    state, images = looking((0.0, 0.0, distance), (0.1, 0.0, -1.0)), []
    for leds in ((led,), _as_points(led, 3000)):
        camera = make_camera(pinhole(96, 1.6), leds=leds)
        images.append(_radiance(make_model(_floor(look), camera), camera, state, FREE)[..., 0])
    disc, points = images
    assert points.max() > 2.0 * np.median(points)
    assert np.sqrt(np.mean((disc - points) ** 2)) < 0.012 * points.mean()
    assert np.abs(disc - points).max() < 0.1 * points.max()
    assert disc.sum() == pytest.approx(points.sum(), rel=1e-3)


def test_radius_0_is_the_point_light(rng: np.random.Generator) -> None:
    organ = tube(40, 60, folds=0.4, capped=True, appearance=patterned(rng, relief=3e-4))
    state = looking((0.004, -0.003, 0.05))
    for size in (40, 180):  # bundles of rays and packets
        images = []
        for radius in (None, 0.0, 1e-9):
            leds = led_ring(6, 3.5 * MM) if radius is None else _ring(radius)
            camera = make_camera(pinhole(size), leds=leds)
            images.append(_radiance(make_model(organ, camera), camera, state))
        bare, zero, tiny = images
        np.testing.assert_array_equal(bare, zero)
        # Only edges of shadows are smoothed.
        assert np.mean(np.abs(tiny / np.maximum(bare, 1e-12) - 1.0) < 1e-3) > 0.7
        np.testing.assert_allclose(tiny.mean(), bare.mean(), rtol=3e-3)


@pytest.mark.slow
def test_direct_light_agrees_with_many_points(rng: np.random.Generator) -> None:
    """Filtered visibility behind folds against path tracing, which converges to the disc.

    The discs are large, so that point LEDs differ from them by more than the error of the filter.
    """
    organ = tube(60, 160, length=0.15, folds=0.35, capped=True, appearance=patterned(rng))
    state = looking((0.004, -0.003, 0.04))
    camera = make_camera(pinhole(128), leds=_ring(1.5 * MM))
    model = make_model(organ, camera)
    few, many, other = (
        _radiance(
            model, camera, state, RenderSettings(light="path", spp=n, max_bounces=1, path_seed=k)
        )
        for n, k in ((4, 0), (128, 1), (128, 2))
    )
    ours, hard = (
        _radiance(model, c, state) for c in (camera, make_camera(pinhole(128), leds=_ring(0.0)))
    )

    def rmse(image: np.ndarray) -> float:
        return float(np.sqrt(np.mean((image - many) ** 2)) / many.mean())

    assert rmse(other) < 0.006
    assert rmse(few) > 2.0 * rmse(other)
    assert rmse(ours) < 0.03
    assert rmse(ours) < 0.5 * rmse(hard)
    assert ours.mean() == pytest.approx(many.mean(), rel=5e-3)


def test_soft_shadows_only_darken(rng: np.random.Generator) -> None:
    organ = tube(40, 80, folds=0.4, capped=True, appearance=patterned(rng))
    for size in (60, 180):
        camera = make_camera(pinhole(size), leds=_ring())
        model, state = make_model(organ, camera), looking((0.004, -0.003, 0.05))
        free, shaded = (_radiance(model, camera, state, settings) for settings in (FREE, SHADED))
        assert (shaded <= free * (1.0 + 1e-5)).all()
        assert (shaded >= 0.0).all()
        assert ((shaded < 0.9 * free) & (shaded > 0.1 * free)).mean() > 0.01


def test_labels_do_not_depend_on_the_size_of_leds(rng: np.random.Generator) -> None:
    organ = tube(40, 80, folds=0.4, capped=True, appearance=patterned(rng))
    names = ("depth", "ray_distance", "normal", "label", "instance", "arc_length", "albedo")
    state, frames = looking((0.004, -0.003, 0.05)), []
    for radius in (0.0, RADIUS):
        camera = make_camera(pinhole(180), leds=_ring(radius))
        renderer = Renderer(make_model(organ, camera), RenderSettings())
        frames.append(renderer.render(state, camera, channels=(*names, "rgb")))
    for name in names:
        np.testing.assert_array_equal(getattr(frames[0], name), getattr(frames[1], name))
    assert (frames[0].rgb != frames[1].rgb).any()


def test_a_large_image_is_that_of_its_parts(rng: np.random.Generator) -> None:
    """Images are traced in strips of rows; a part of the image has strips at other places."""
    organ = tube(40, 80, folds=0.4, capped=True, appearance=patterned(rng))
    state, images = looking((0.004, -0.003, 0.05)), []
    for height, first in ((1200, 0), (640, 288)):
        lens = LensPinhole(600.0, 600.0, 11.5, 599.5 - first)
        camera = make_camera((lens, 24, height), leds=_ring())
        images.append(_radiance(make_model(organ, camera), camera, state))
    whole, part = images
    np.testing.assert_allclose(part[32:-32], whole[320:896], rtol=1e-3, atol=1e-6 * whole.max())


def _scene(size: int) -> tuple[Model, Camera, State]:
    organ = tube(40, 60, folds=0.4, capped=True, appearance=patterned(np.random.default_rng(5)))
    camera = make_camera(pinhole(size), leds=_ring())
    return make_model(organ, camera), camera, looking((0.004, -0.003, 0.05))


def digest() -> str:
    """Checksum of images with soft shadows, in both orders."""
    model, camera, state = _scene(96)
    out = b""
    for settings in (SHADED, RenderSettings(), RenderSettings(light="path", spp=2, max_bounces=2)):
        renderer = Renderer(model, settings)
        other = looking((0.0, 0.004, 0.03))
        first, _, again = (
            np.asarray(renderer.render(s, camera, channels=RADIANCE).radiance).tobytes()
            for s in (state, other, state)
        )
        assert first == again
        out += first
    return hashlib.sha256(out).hexdigest()


def test_same_bytes_for_any_number_of_threads() -> None:
    _, digests = digests_by_threads(digest, (1, 3))
    assert len(set(digests)) == 1


def test_a_batch_has_the_bytes_of_single_images() -> None:
    model, camera, state = _scene(180)
    renderer = Renderer(model, SHADED)
    pose = state.T_world_capsule @ camera.T_capsule_camera
    batch = render_batch([renderer], pose[None], camera, ("rgb", "radiance"))
    frame = renderer.render(state, camera, channels=("rgb", "radiance"))
    for name in ("rgb", "radiance"):
        np.testing.assert_array_equal(batch[name][0], getattr(frame, name))
