"""Light through tissue: walks beside exact transport, diffusion, another walk, and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.validation.scattering_theory import (
    Medium,
    diffusion_profile,
    dipole_profile,
    half_space_reflectance,
)
from tests.support.shapes import looking, make_camera, make_model, make_organ, pinhole, sphere, tube
from vrcaps import _core
from vrcaps.camera.camera import Camera, Led
from vrcaps.core.errors import InputError
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer
from vrcaps.render.scattering import (
    TISSUE_IOR,
    albedo_roots,
    angular_slopes,
    diffuse_reflectance,
    diffuse_transmittance,
    fresnel,
    half_space_albedo,
    internal_reflectance,
    mean_cosine,
    reduced_scattering,
)
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

SIZE = 0.2
JUST_INSIDE = (0.0, 0.0, -3e-7)
DOWN = (0.0, 0.0, -1.0)
INDICES = (1.0, 1.33, TISSUE_IOR, 1.5)


def _plane(height: float = 0.0, *, up: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a large square at a height, whose normals point up or down."""
    corners = SIZE * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    corners[:, 2] = height
    return corners, faces if up else faces[:, ::-1]


def _slab(thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Tissue between z = −thickness and 0."""
    (top, faces), (bottom, others) = _plane(), _plane(-thickness, up=False)
    return np.vstack([top, bottom]), np.vstack([faces, others + 4])


def _walks(mesh: tuple, albedo: tuple, extinction: tuple, ior: float, count: int, seed: int = 1):
    wall = _core.Wall(mesh[0], np.ascontiguousarray(mesh[1]))
    return _core.walk_tissue(
        wall, JUST_INSIDE, DOWN, albedo=albedo, extinction=extinction, ior=ior, count=count,
        seed=seed,
    )  # fmt: skip


def test_border_in_closed_form():
    """Head-on ((n − 1)/(n + 1))²; total reflection; the same from both sides."""
    for ior in (1.33, 1.4, 1.5):
        assert fresnel(np.array(1.0), ior) == pytest.approx(((ior - 1.0) / (ior + 1.0)) ** 2)
        outside = np.linspace(0.05, 1.0, 50)
        inside = np.sqrt(1.0 - (1.0 - outside**2) / ior**2)
        np.testing.assert_allclose(fresnel(outside, ior), fresnel(inside, 1.0 / ior), atol=1e-12)
        critical = np.sqrt(1.0 - 1.0 / ior**2)
        np.testing.assert_allclose(fresnel(critical * np.linspace(0.0, 0.999, 9), 1.0 / ior), 1.0)


@pytest.mark.parametrize("ior", [1.2, 1.4, 1.5])
def test_share_that_enters_in_closed_form(ior: float):
    """Even light, integrated by Walsh (1926) as given by Duntley (J. Opt. Soc. Am. 32, 1942)."""
    n, square = ior, ior**2
    reflected = (
        0.5
        + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0) ** 2)
        + square * (square - 1.0) ** 2 / (square + 1.0) ** 3 * np.log((n - 1.0) / (n + 1.0))
        - 2.0 * n**3 * (square + 2.0 * n - 1.0) / ((square + 1.0) * (n**4 - 1.0))
        + 8.0 * n**4 * (n**4 + 1.0) / ((square + 1.0) * (n**4 - 1.0) ** 2) * np.log(n)
    )
    assert diffuse_transmittance(ior) == pytest.approx(1.0 - reflected, abs=1e-5)


def test_reflectance_published():
    """Giovanelli (Optica Acta 2, 1955): 0.2600 with the border's 4 % for albedo 0.9 and index 1.5,
    as MCML's authors quote it (Wang et al., Comput. Methods Programs Biomed. 47, 1995, table 2)."""
    inside = half_space_reflectance(np.array([0.9]), 1.5)[0]
    assert inside + fresnel(np.array(1.0), 1.5) == pytest.approx(0.2600, abs=1e-4)


@pytest.mark.parametrize("ior", INDICES)
def test_color_of_the_limits(ior: float):
    """Without absorption all comes back, without scattering nothing; more albedo is brighter."""
    color = half_space_albedo(1.0 - np.geomspace(1e-10, 1.0, 30), ior)
    assert color[0] == pytest.approx(1.0, abs=2e-4)
    assert color[-1] == pytest.approx(0.0, abs=1e-12)
    assert (np.diff(color) < 0.0).all()


def test_color_of_a_half_space_without_border():
    """1 − 2 √(1 − ϖ) ∫ H μ dμ, by H of the limit ϖ → 0: 1 + ϖ μ ln(1 + 1/μ)/2 (Chandrasekhar)."""
    faint = 1e-3
    mu = (np.arange(20_000) + 0.5) / 20_000
    h = 1.0 + 0.5 * faint * mu * np.log(1.0 + 1.0 / mu)
    expected = 1.0 - 2.0 * np.sqrt(1.0 - faint) * np.mean(h * mu)
    assert half_space_albedo(np.array([faint]), 1.0)[0] == pytest.approx(expected, rel=2e-3)


def test_colors_are_given_back():
    roots = albedo_roots()
    colors = np.linspace(0.0, 1.0, len(roots))
    given = half_space_albedo(1.0 - roots**2, TISSUE_IOR)
    some = (colors > 0.02) & (colors < 0.97)
    np.testing.assert_allclose(given[some], colors[some], rtol=4e-3)


@pytest.mark.parametrize("color", [0.03, 0.2, 0.5, 0.8])
def test_brightness_by_angle(color: float):
    """A straight line through exact transport: the same mean, and within 2 % head-on."""
    place = np.linspace(0.0, 1.0, len(albedo_roots()))
    root, slope = (np.interp(color, place, table) for table in (albedo_roots(), angular_slopes()))
    less = mean_cosine(TISSUE_IOR) - 1.0
    passes = (1.0 - fresnel(np.array(1.0), TISSUE_IOR)) / diffuse_transmittance(TISSUE_IOR)
    back = half_space_reflectance(np.array([1.0 - root**2]), TISSUE_IOR)[0]
    exact = back / diffuse_transmittance(TISSUE_IOR)
    assert color * passes * (1.0 + slope * less) == pytest.approx(exact, rel=0.02)
    assert mean_cosine(1.0) == pytest.approx(2.0 / 3.0)


def test_measured_scattering():
    """Marchesini et al. (1994): 14.2 per cm at 300 nm, 6.2 at 800 nm."""
    assert reduced_scattering(300.0) == pytest.approx(1420.0)
    assert reduced_scattering(800.0) == pytest.approx(620.0, rel=1e-3)


def test_diffusion_of_the_limits():
    """Nothing absorbed, all comes back; much absorbed, nothing does; little, as in transport."""
    for ior in INDICES:
        internal = internal_reflectance(ior)
        ends = diffuse_reflectance(np.array([0.0, 1e6]), internal=internal)
        np.testing.assert_allclose(ends, [1.0, 0.0], atol=1e-6)
        albedo = np.array([0.98, 0.99, 0.999])
        exact = half_space_reflectance(albedo, ior) / (1.0 - fresnel(np.array(1.0), ior))
        found = diffuse_reflectance(1.0 / albedo - 1.0, internal=internal)
        np.testing.assert_allclose(found, exact, rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("ior", INDICES)
def test_walks_agree_with_transport(ior: float):
    """Three colors of other albedo and free way at once, each within four standard errors."""
    albedo, count = (0.99, 0.9, 0.6), 60_000
    _, share = _walks(_plane(), albedo, (700.0, 1000.0, 1600.0), ior, count)
    passes = 1.0 - fresnel(np.array(1.0), ior)
    expected = half_space_reflectance(np.array(albedo), ior) / passes
    error = share.std(axis=0) / np.sqrt(count)
    assert (np.abs(share.mean(axis=0) - expected) < 4.0 * error).all()
    assert (error < 0.01 * expected).all() or ior > 1.0


def test_walks_go_straight_through_clear_tissue():
    """Without scattering what crosses a slab is exp(−µ d) (Beer and Lambert), in every color."""
    extinction, thickness, count = (300.0, 700.0, 1500.0), 1e-3, 40_000
    place, share = _walks(_slab(thickness), (0.0,) * 3, extinction, 1.0, count)
    through = np.where(place[:, 2:] < -0.5 * thickness, share, 0.0)
    expected = np.exp(-np.array(extinction) * thickness)
    error = through.std(axis=0) / np.sqrt(count)
    assert (np.abs(through.mean(axis=0) - expected) < 4.0 * error).all()


def test_nothing_is_lost_in_white_tissue():
    place, share = _walks(_slab(2e-3), (1.0,) * 3, (1000.0,) * 3, TISSUE_IOR, 2000)
    assert np.isfinite(place).all()
    np.testing.assert_allclose(share, 1.0, rtol=1e-4)
    sides = place[:, 2]
    np.testing.assert_allclose(np.where(sides > -1e-3, sides, sides + 2e-3), 0.0, atol=1e-7)


@pytest.mark.validation
def test_profile_far_from_the_beam_is_that_of_diffusion():
    """Diffusion holds beyond six mean free paths, where light has lost its direction."""
    count, edges = 120_000, np.array([6e-3, 9e-3, 14e-3])
    for ior in (1.0, TISSUE_IOR):
        place, share = _walks(_plane(), (0.995,) * 3, (1000.0,) * 3, ior, count)
        radius = np.hypot(place[:, 0], place[:, 1])
        found = _binned(radius, share[:, 0], edges)
        medium = Medium(5.0, 995.0, ior)
        expected = np.array([_ring(diffusion_profile, medium, *e) for e in pairwise(edges)])
        assert (np.abs(found[0] - expected) < 0.03 * expected + 3.0 * found[1]).all()


def test_profiles_hold_all_that_comes_back():
    """Integrals over the surface: of the dipole a(1 + e^(−4ks/3))e^(−s)/2 (Farrell, eq. 15)."""
    medium = Medium(20.0, 980.0)
    internal = internal_reflectance(medium.ior)
    k, s = (1.0 + internal) / (1.0 - internal), np.sqrt(3.0 * 0.02)
    expected = 0.98 / 2.0 * (1.0 + np.exp(-4.0 / 3.0 * k * s)) * np.exp(-s)
    assert _ring(dipole_profile, medium, 0.0, 0.1) == pytest.approx(expected, rel=1e-3)
    exact = half_space_reflectance(np.array([0.98]), medium.ior)[0] / (
        1.0 - fresnel(np.array(1.0), 1.4)
    )
    assert _ring(diffusion_profile, medium, 0.0, 0.1) == pytest.approx(exact, rel=0.06)


def _ring(profile: Callable, medium: Medium, inner: float, outer: float) -> float:
    """Share of the light that comes back between two distances from the beam."""
    x, w = np.polynomial.legendre.leggauss(400)
    # Finer towards the beam.
    part = 0.25 * (x + 1.0) ** 2
    radius = inner + (outer - inner) * part
    step = (outer - inner) * 0.5 * (x + 1.0) * w
    return float(np.sum(profile(medium, radius) * 2.0 * np.pi * radius * step))


@pytest.mark.parametrize("ior", [1.0, TISSUE_IOR])
def test_walks_agree_with_another_walk(ior: float, rng: np.random.Generator):
    """Through a slab, and how far from the beam: beside walks in NumPy that know planes only."""
    albedo, thickness, count = 0.95, 3e-3, 60_000
    place, share = _walks(_slab(thickness), (albedo,) * 3, (1000.0,) * 3, ior, count)
    theirs, weight = _walked_slab(albedo, 1e3 * thickness, ior, count, rng)
    edges = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, np.inf])
    for ours_side, their_side in ((place[:, 2] > -1e-4, theirs[:, 2] > -0.1),
                                  (place[:, 2] < -2e-3, theirs[:, 2] < -2.0)):  # fmt: skip
        radius = 1e3 * np.hypot(place[:, 0], place[:, 1])
        ours = _binned(radius, share[:, 0] * ours_side, edges)
        other = _binned(np.hypot(theirs[:, 0], theirs[:, 1]), weight * their_side, edges)
        z = (ours[0] - other[0]) / np.hypot(ours[1], other[1])
        assert np.abs(z).max() < 4.0
        assert np.mean(z**2) < 2.5


def _binned(radius: np.ndarray, weight: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean weight in each ring, and its standard error."""
    ring = np.searchsorted(edges, np.nan_to_num(radius, nan=-1.0)) - 1
    values = np.where(ring[:, None] == np.arange(len(edges) - 1), weight[:, None], 0.0)
    return np.array([values.mean(axis=0), values.std(axis=0) / np.sqrt(len(radius))])


def _walked_slab(
    albedo: float, thickness: float, ior: float, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Places and weights of light that leaves a slab; lengths in free ways, as MCML does it."""
    place, way = np.zeros((count, 3)), np.tile([0.0, 0.0, -1.0], (count, 1))
    weight, left = np.ones(count), rng.exponential(size=count)
    out_place, out_weight = np.full((count, 3), np.nan), np.zeros(count)
    alive = np.arange(count)
    while len(alive):
        wall = np.where(way[:, 2] > 0.0, 0.0, -thickness)
        to_wall = (wall - place[:, 2]) / way[:, 2]
        meets = to_wall < left
        place = place + np.where(meets, to_wall, left)[:, None] * way
        place[meets, 2] = wall[meets]
        left = left - to_wall
        back = rng.random(len(alive)) < fresnel(np.abs(way[:, 2]), 1.0 / ior)
        leaves = meets & ~back
        out_place[alive[leaves]], out_weight[alive[leaves]] = place[leaves], weight[leaves]
        way[meets & back, 2] *= -1.0
        turns = ~meets
        cosine, turn = (
            rng.uniform(-1.0, 1.0, turns.sum()),
            rng.uniform(0.0, 2.0 * np.pi, turns.sum()),
        )
        sine = np.sqrt(1.0 - cosine**2)
        way[turns] = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
        left[turns] = rng.exponential(size=turns.sum())
        ends = turns & (rng.random(len(alive)) >= albedo)
        keep = ~(leaves | ends)
        place, way, weight, left, alive = (a[keep] for a in (place, way, weight, left, alive))
    return out_place, out_weight


def _matt(color: int) -> Appearance:
    """A look that mirrors nothing, so that all light goes through tissue."""
    flat = np.full((1, 1, 3), color, np.uint8)
    return Appearance(
        flat, np.full((1, 1), 128, np.uint8), np.zeros((1, 1)), ior=1.0, clearcoat=0.0
    )


def _albedo(color: int) -> np.ndarray:
    """Single-scattering albedo [1] of tissue behind such a look."""
    linear = ((color / 255 + 0.055) / 1.055) ** 2.4
    roots = albedo_roots()
    return 1.0 - np.interp([linear], np.linspace(0.0, 1.0, len(roots)), roots) ** 2


def _radiance(model: Model, camera: Camera, state: State, **settings: int | bool) -> np.ndarray:
    chosen = RenderSettings(light="path", **{"scattering": True, **settings})
    radiance = Renderer(model, chosen).render(state, camera, channels=("radiance",)).radiance
    assert radiance is not None
    return radiance.astype(float)


@pytest.mark.slow
@pytest.mark.parametrize(("color", "spp"), [(90, 128), (190, 128), (240, 32)])
def test_wall_of_a_large_sphere(color: int, spp: int):
    """Seen and lit head-on from its middle: exact transport of the half-space.

    In a bright wall, walks are long, and vary less in what they bring back.
    """
    led = Led((0.0, 0.0, 0.0), lobe_exponent=0.0, intensity=(1e-3,) * 3)
    camera = make_camera(pinhole(24), leds=(led,))
    model = make_model(sphere(4, radius=0.5, appearance=_matt(color)), camera)
    found = _radiance(model, camera, looking((0.0, 0.0, 0.0)), spp=spp, max_bounces=1)
    back = half_space_reflectance(_albedo(color), TISSUE_IOR)[0]
    head_on = 1.0 - fresnel(np.array(1.0), TISSUE_IOR)
    expected = 1e-3 / 0.5**2 / np.pi * back * head_on / diffuse_transmittance(TISSUE_IOR) ** 2
    np.testing.assert_allclose(found.mean(), expected, rtol=0.015)


def test_a_thin_sheet_shines_through(rng: np.random.Generator):
    """Lit from behind, as bright as walks in NumPy say; without scattering it is black."""
    thickness, color, away = 1e-3, 190, 0.03
    vertices, faces = _slab(thickness)
    led = Led((0.0, 0.0, 2.0 * away), lobe_exponent=0.0, intensity=(1e-3,) * 3)
    camera = make_camera(pinhole(16, 0.3), leds=(led,))
    model = make_model(make_organ(vertices, faces, appearance=_matt(color)), camera)
    state = looking((0.0, 0.0, away), (0.0, 0.0, -1.0))
    found = _radiance(model, camera, state, spp=256, max_bounces=1)[..., 1]
    assert not _radiance(model, camera, state, spp=1, max_bounces=3, scattering=False).any()
    albedo = _albedo(color)[0]
    free = albedo / reduced_scattering(545.0)
    place, weight = _walked_slab(albedo, thickness / free, TISSUE_IOR, 60_000, rng)
    through = np.mean(weight * (place[:, 2] < -0.5 * thickness / free))
    passes = (1.0 - fresnel(np.array(1.0), TISSUE_IOR)) / diffuse_transmittance(TISSUE_IOR)
    expected = through * passes**2 / np.pi * 1e-3 / (away - thickness) ** 2
    np.testing.assert_allclose(found.mean(), expected, rtol=0.04)


@pytest.mark.slow
def test_more_reflections_are_brighter_and_labels_stay():
    look = replace(_matt(190), ior=1.4, clearcoat=0.7)
    organ = tube(40, 80, folds=0.35, capped=True, appearance=look)
    camera = make_camera("scaramuzza")
    model, state = make_model(organ, camera), looking((0.004, -0.003, 0.05))
    images = [_radiance(model, camera, state, spp=6, max_bounces=d) for d in (1, 2, 4)]
    means = [image.mean() for image in images]
    assert means[0] < means[1] < means[2] < 2.5 * means[0]
    np.testing.assert_array_equal(images[0], _radiance(model, camera, state, spp=6, max_bounces=1))
    names = ("depth", "normal", "label", "instance", "albedo", "position")
    frames = [
        Renderer(model, RenderSettings(light="path", spp=1, scattering=on)).render(
            state, camera, channels=(*names, "rgb")
        )
        for on in (False, True)
    ]
    for name in names:
        np.testing.assert_array_equal(*(getattr(frame, name) for frame in frames))


def test_wrong_input():
    with pytest.raises(
        InputError, match=r"requires light 'radiosity' or 'path', not 'direct'\. Change one"
    ):
        RenderSettings(light="direct", scattering=True)
    with pytest.raises(ValueError, match="albedo of 0 to 1, extinction above 0 and an index of 1"):
        _walks(_plane(), (1.2,) * 3, (1000.0,) * 3, 1.4, 1)
