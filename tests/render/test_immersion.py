"""Turbid fluid and the film on the dome, against closed forms, quadrature and random walks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from tests.support import twin_medium
from vrcaps import _core
from vrcaps.camera.camera import camera_rays
from vrcaps.camera.derive import scaled_camera
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.lumen.contents import Contents, Film, Medium
from vrcaps.render.immersion import _NOISE_DEVIATION, film_relief, order_ratio, shell_distance
from vrcaps.render.renderer import Renderer
from vrcaps.world.model import Model

_START = 4e-3
_DISTANCE = 20e-3


def _immersed(*, orders=(0.0, 0.0, 0.0), rays=None, distance=_DISTANCE, led=(0.0,) * 3, **medium):
    """Core's images of a wall of radiance 1 at a distance, with an isotropic LED of 1 W/sr."""
    given = {
        "absorption": (0.0, 0.0, 0.0),
        "stain": (0.0, 0.0, 0.0),
        "scattering": (0.0, 0.0, 0.0),
        "anisotropy": 0.0,
        "orders": orders,
        "clouds": (0.0, 1.0),
        "flocs": (0.0, 1.0),
        "floc_color": (1.0, 1.0, 1.0),
        "seed": 1,
    } | medium
    size = (9, 13)
    if rays is None:
        rays = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (*size, 1))
    planes = np.ones((3, *rays.shape[:2]), np.float32)
    distances = np.full(rays.shape[:2], distance, np.float32)
    start = np.full(rays.shape[:2], _START, np.float32)
    leds = np.array([[*led, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]])
    veil, clear = _core.immerse(planes, rays, distances, start, np.eye(4), leds, given)
    return planes, veil, clear


@pytest.mark.parametrize(("name", "clouds"), [("absorption", 0.0), ("stain", 0.8)])
def test_wall_is_attenuated_on_both_ways(name, clouds):
    absorption = np.array([10.0, 30.0, 90.0])
    planes, veil, clear = _immersed(**{name: tuple(absorption)}, clouds=(clouds, 6e-3))
    expected = np.exp(-2.0 * absorption * (_DISTANCE - _START))
    assert np.allclose(planes[:, 4, 6], expected, rtol=1e-4)
    assert not veil.any()
    assert (clear == 1.0).all()


def test_forward_scattering_does_not_attenuate_but_blurs():
    planes, _, clear = _immersed(scattering=(100.0,) * 3, anisotropy=0.999)
    assert planes.min() > 0.99
    assert np.allclose(clear, np.exp(-99.9 * (_DISTANCE - _START)), rtol=1e-3)


@pytest.mark.parametrize("offset", [0.0, 3e-3])
def test_veil_is_the_integral_of_single_scattering(offset):
    scattering, absorption = 40.0, 25.0
    _, veil, _ = _immersed(
        scattering=(scattering,) * 3, absorption=(absorption,) * 3, led=(offset, 0.0, 0.0)
    )

    def light(t):
        way = np.hypot(t, offset)
        depth = (scattering + absorption) * (max(way - _START, 0.0) + t - _START)
        return scattering / (4.0 * np.pi) / way**2 * np.exp(-depth)

    expected, _ = quad(light, _START, _DISTANCE)
    assert np.allclose(veil, expected, rtol=0.01)
    # Without extinction it would be 2.3 times as bright.
    assert quad(lambda t: scattering / (4.0 * np.pi) / t**2, _START, _DISTANCE)[0] > 1.5 * expected


def test_veil_ends_at_the_wall_of_each_pixel():
    kind = {"scattering": (40.0,) * 3}
    near, far = (_immersed(distance=d, **kind)[1].mean() for d in (8e-3, 30e-3))
    assert 0.0 < near < far


def _backscattered(albedo, rng, count=40_000):
    """Light that a half-space of isotropic scattering sends back along the normal, over that of
    the first order, by random walks with next-event estimation."""
    depth, cosine = np.zeros(count), np.ones(count)
    weight, total, first = np.ones(count), 0.0, 0.0
    for order in range(60):
        depth = depth + cosine * rng.exponential(1.0, count)
        inside = depth > 0.0
        weight = np.where(inside, weight * albedo, 0.0)
        sent = float((weight * np.exp(-np.maximum(depth, 0.0))).sum())
        first = sent if order == 0 else first
        total += sent
        cosine = rng.uniform(-1.0, 1.0, count)
    return total / first


@pytest.mark.parametrize("albedo", [0.3, 0.7, 0.9])
def test_orders_of_scattering_add_up_to_a_half_space(albedo):
    walked = _backscattered(albedo, np.random.default_rng(5))
    assert 1.0 / (1.0 - order_ratio(albedo)) == pytest.approx(walked, rel=0.03)
    assert walked > 1.05  # single scattering alone would miss this


def test_further_orders_brighten_up_to_those_of_a_half_space():
    kind = {"scattering": (2000.0,) * 3, "absorption": (500.0,) * 3}
    ratio = order_ratio(0.8)
    single = _immersed(**kind)[1].mean()
    many = _immersed(orders=(ratio,) * 3, **kind)[1].mean()
    assert 1.2 * single < many < single / (1.0 - ratio)


def test_clouds_are_fixed_and_seeded():
    rays = camera_rays(read_device("mirocam").cameras[0]).astype(np.float32)
    kind = {"rays": rays, "scattering": (100.0,) * 3, "clouds": (0.8, 6e-3), "flocs": (500.0, 2e-3)}
    one, again, other = (_immersed(seed=seed, **kind)[1] for seed in (1, 1, 2))
    assert one.tobytes() == again.tobytes() != other.tobytes()
    lit = np.isfinite(rays).all(axis=-1)
    assert np.isfinite(one).all()
    assert not one[:, ~lit].any()
    smooth = _immersed(**(kind | {"clouds": (0.0, 1.0), "flocs": (0.0, 1.0)}))[1]
    assert (
        one[1, lit].std() / one[1, lit].mean() > 1.5 * smooth[1, lit].std() / smooth[1, lit].mean()
    )


def test_core_agrees_with_its_twin():
    camera = read_device("mirocam").cameras[0]
    rays = camera_rays(scaled_camera(camera, 0.1)).astype(np.float32)
    size = rays.shape[:2]
    rng = np.random.default_rng(2)
    distance = rng.uniform(5e-3, 40e-3, size).astype(np.float32)
    distance[rng.random(size) < 0.1] = np.nan
    start = rng.uniform(3e-3, 5e-3, size).astype(np.float32)
    pose = transform_from(rotation_from_vector(np.array([0.3, -0.5, 0.9])), [0.2, -0.1, 0.4])
    leds = np.array(
        [
            [x, 2e-3, 0.0, 0.0, 0.0, 1.0, 1.0, 0.9, 0.7, power, 0.0]
            for x, power in ((3e-3, 1), (0, 0))
        ]
    )
    medium = {
        "absorption": (10.0, 20.0, 80.0),
        "stain": (2.0, 5.0, 25.0),
        "scattering": (150.0, 140.0, 130.0),
        "anisotropy": 0.8,
        "orders": (0.7, 0.5, 0.3),
        "clouds": (0.6, 6e-3),
        "flocs": (400.0, 2e-3),
        "floc_color": (0.9, 0.8, 0.5),
        "seed": 12345,
    }
    ours, theirs = (np.ones((3, *size), np.float32) for _ in range(2))
    seen = _core.immerse(ours, rays, distance, start, pose, leds, medium)
    known = twin_medium.immerse(theirs, rays, distance, start, pose, leds, medium)
    for one, other in zip((ours, *seen), (theirs, *known), strict=True):
        assert np.allclose(one, other, rtol=2e-3, atol=2e-3 * np.abs(other).max())
    lit, fraction = np.isfinite(rays).all(axis=-1), rng.random(size).astype(np.float32)
    _core.scatter_forward(ours, lit, fraction, 2.0)
    twin_medium.scatter_forward(theirs, lit, fraction, 2.0)
    assert np.allclose(ours, theirs, atol=5e-3)


def test_flocs_that_rays_cannot_resolve_fade_to_their_mean():
    rays = camera_rays(read_device("mirocam").cameras[0]).astype(np.float32)
    lit = np.isfinite(rays).all(axis=-1)

    def contrast(size: float, extinction: float = 20.0, **kind) -> tuple[float, float]:
        clear = _immersed(rays=rays, flocs=(extinction, size), distance=40e-3, **kind)[0][1, lit]
        depth = -np.log(clear)
        return float(depth.mean()), float(depth.std())

    mean, spread = contrast(0.2e-3)
    # Light passes the fluid twice; the LED is at the camera.
    assert mean == pytest.approx(2.0 * 20.0 * twin_medium.MEAN_FLOCS * 36e-3, rel=0.02)
    assert spread < 0.02 * mean
    coarse_mean, coarse_spread = contrast(8e-3)
    assert coarse_mean == pytest.approx(mean, rel=0.5)
    assert coarse_spread > 0.5 * coarse_mean


def test_noise_has_the_stated_deviation():
    points = np.random.default_rng(0).uniform(-50.0, 50.0, (20_000, 3))
    noise = twin_medium.fractal(points, 5)
    assert noise.std() == pytest.approx(_NOISE_DEVIATION, rel=0.03)
    assert abs(noise.mean()) < 0.02


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="of one size"):
        _core.scatter_forward(
            np.zeros((3, 4, 4), np.float32),
            np.ones((4, 5), bool),
            np.zeros((4, 4), np.float32),
            1.0,
        )


@pytest.mark.parametrize("sigma", [1.5, 9.0])
def test_forward_scattering_is_a_gaussian(sigma):
    size = 121
    planes = np.zeros((3, size, size), np.float32)
    planes[:, 60, 60] = 1.0
    lit, half = np.ones((size, size), bool), np.full((size, size), 0.5, np.float32)
    _core.scatter_forward(planes, lit, half, sigma)
    assert planes[0, 60, 60] > 0.5
    planes[:, 60, 60] -= 0.5
    assert planes[0].sum() == pytest.approx(0.5, rel=0.02)
    x = np.arange(size) - 60.0
    variance = (planes[0].sum(axis=0) * x**2).sum() / planes[0].sum()
    assert np.sqrt(variance) == pytest.approx(sigma, rel=0.08)


def test_blur_keeps_an_even_image_up_to_its_outline():
    rays = camera_rays(read_device("mirocam").cameras[0])
    lit = np.isfinite(rays).all(axis=-1)
    planes = np.where(lit, np.float32(0.7), np.float32(0.0))[None].repeat(3, 0).copy()
    _core.scatter_forward(planes, lit, lit.astype(np.float32), 6.0)
    assert np.allclose(planes[:, lit], 0.7, rtol=1e-4)
    assert not planes[:, ~lit].any()


def test_rays_leave_a_spherical_front_at_its_radius():
    device = read_device("mirocam")
    pose = np.eye(4)
    pose[2, 3] = 0.5 * device.length - device.radius
    rays = camera_rays(device.cameras[0])
    assert np.allclose(shell_distance(device, pose, rays)[rays[..., 2] > 0.0], device.radius)
    side = np.array([[[1.0, 0.0, 0.0]]])
    assert shell_distance(device, np.eye(4), side)[0, 0] == pytest.approx(device.radius)


def test_amounts_along_the_gut_have_their_prevalence():
    places = np.arange(4000) * 0.013
    for kind, amount in ((Medium(prevalence=0.3), "density"), (Film(prevalence=0.6), "depth")):
        present = np.array([getattr(kind, amount)(s, 7) for s in places]) > 0.0
        assert present.mean() == pytest.approx(kind.prevalence, abs=0.07)
        assert getattr(replace(kind, prevalence=0.0), amount)(0.2, 7) == 0.0
    dense = [Medium(spread=0.5).density(s, 3) for s in places]
    assert np.log(dense).std() == pytest.approx(0.5, abs=0.05)
    assert np.abs(np.diff(np.log(dense))).max() < 2.0


def test_clear_fluid_stains_a_view_without_turbidity(tube):
    state, channels = Model(tube, read_device("mirocam")).place(), ("radiance", "ray_distance")
    stained, clear = (
        Renderer(Model(tube, read_device("mirocam"), contents=Contents(medium=medium))).render(
            state, "front", channels=channels
        )
        for medium in (Medium(prevalence=0.0, stain=(0.0, 5.0, 25.0)), 0)
    )
    lit = np.isfinite(clear.ray_distance) & (clear.radiance.min(axis=-1) > 0.0)
    red, green, blue = (stained.radiance[lit] / clear.radiance[lit]).T
    assert np.allclose(red, 1.0, rtol=1e-3)
    assert np.allclose(np.log(blue), 5.0 * np.log(green), atol=0.02)
    far, near = np.quantile(clear.ray_distance[lit], [0.9, 0.1])
    is_far, is_near = clear.ray_distance[lit] > far, clear.ray_distance[lit] < near
    assert blue[is_far].mean() < blue[is_near].mean() < 1.0


def test_film_differs_over_the_dome_and_with_travel():
    angles = np.stack(np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-1, 1, 40)), axis=-1)
    relief = film_relief(Film(), angles, 3, 0)
    assert relief(0.1).mean() == pytest.approx(1.0, abs=0.4)
    assert relief(0.1).std() > 0.2
    step = np.abs(relief(0.1) - relief(0.1 + 1e-4)).max()
    assert 0.0 < step < 0.1 < np.abs(relief(0.1) - relief(0.3)).max()


@pytest.mark.parametrize("name", ["medium", "film"])
def test_labels_are_those_of_the_wall(name, tube):
    model = Model(tube, read_device("mirocam"))
    state, channels = model.place(), ("radiance", "rgb", "depth", "label", "normal")
    clear = Renderer(model).render(state, "front", channels=channels)
    turbid = replace(model, contents=Contents(**{name: 3}))
    assert turbid.lumen_contents is None
    seen = Renderer(turbid).render(state, "front", channels=channels)
    for channel in ("depth", "label", "normal"):
        assert getattr(seen, channel).tobytes() == getattr(clear, channel).tobytes()
    lit = np.isfinite(clear.depth)
    assert np.abs(seen.radiance - clear.radiance)[lit].mean() > 0.02 * clear.radiance[lit].mean()
    assert not np.array_equal(seen.rgb, clear.rgb)


def test_invalid_settings_are_refused():
    with pytest.raises(InputError, match="Medium's prevalence is 2"):
        Medium(prevalence=2.0)
    with pytest.raises(InputError, match="Medium's absorption"):
        Medium(absorption=(-1.0, 0.0, 0.0))
    with pytest.raises(InputError, match="Medium's stain"):
        Medium(stain=(0.0, 0.0, -1.0))
    with pytest.raises(InputError, match="Medium's floc_color"):
        Medium(floc_color=(2.0, 0.0, 0.0))
    with pytest.raises(InputError, match="Film's thickness is 1"):
        Film(thickness=1.0)
    with pytest.raises(InputError, match="Contents' medium"):
        Contents(medium=5)
