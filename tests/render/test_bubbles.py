"""Light that bubbles reflect and transmit against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tests.render.test_contents import balls, crossing
from tests.support.shapes import (
    DIRECT,
    RADIUS,
    looking,
    make_camera,
    make_model,
    patterned,
    pinhole,
    sphere,
)
from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.core.geometry import unit
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Bubbles, Contents
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.particles import BUBBLE
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Frame, Renderer
from vrcaps.render.scattering import fresnel

FILM = Bubbles(gleam=0.0, shade=0.0, stain=(0.0, 0.0, 0.0), ripple=0.0, meniscus=1e-12)
"""A shell that has emerged from the liquid, without rim, shade and deformation."""

INTENSITY = 2e-3


class Scene:
    """Bubbles at positions in the camera frame, in a sphere that an LED at the eye lights."""

    def __init__(
        self,
        size: int = 160,
        led: tuple[float, float, float] = (0.0, 0.0, 0.0),
        appearance: Appearance | None = None,
    ) -> None:
        light = Led(led, (0.0, 0.0, 1.0), (INTENSITY,) * 3, 1.0)
        self.camera: Camera = replace(make_camera(pinhole(size)), leds=(light,))
        self.renderer = Renderer(make_model(sphere(4, appearance=appearance), self.camera), DIRECT)
        self.state = looking((0.0, 0.0, 0.0))
        self.rays = camera_rays(self.camera).astype(float)

    def render(
        self, bubbles: Bubbles, centers: object, radius: object, color: float = 0.0
    ) -> Frame:
        T = self.state.T_world_capsule @ self.camera.T_capsule_camera
        placed = np.atleast_2d(np.asarray(centers, float)) @ T[:3, :3].T + T[:3, 3]
        spheres = balls(placed, radius, BUBBLE)
        spheres = replace(spheres, color=np.full((len(placed), 3), color))
        contents = LumenContents(Contents(bubbles, 1, 1), spheres, None)
        return self.renderer.render(
            replace(self.state, lumen_contents=contents),
            self.camera,
            channels=("radiance", "albedo", "depth", "foreground_instance", "foreground_depth"),
        )

    def radiance(
        self, bubbles: Bubbles, centers: object, radius: object, color: float = 0.0
    ) -> np.ndarray:
        return self.render(bubbles, centers, radius, color).radiance.astype(float)

    def empty(self) -> np.ndarray:
        return self.wall().radiance.astype(float)

    def wall(self) -> Frame:
        return self.renderer.render(
            self.state, self.camera, channels=("radiance", "albedo", "depth")
        )

    def miss(self, center: np.ndarray, radius: float) -> np.ndarray:
        """Squared distance of the rays from a center over the squared radius."""
        return (np.linalg.norm(np.cross(self.rays, center), axis=-1) / radius) ** 2


def film(cosine: np.ndarray, ior: float = FILM.ior) -> np.ndarray:
    """Fraction of light that a film reflects."""
    surface = fresnel(cosine, ior)
    return 2.0 * surface / (1.0 + surface)


def test_a_bubble_mirrors_the_wall_at_twice_the_angle() -> None:
    """Light added by the surroundings' color, compared with the fraction mirrored by each pixel.

    A shell met at angle θ turns a ray by π − 2θ; the middle mirrors what no LED lights.
    """
    scene, distance, radius = Scene(), 6.0 * MM, 1.5 * MM
    center = np.array([0.0, 0.0, distance])
    lit_, dark = (scene.radiance(FILM, center, radius, color) for color in (0.5, 0.0))
    miss = scene.miss(center, radius)
    inner = miss < 0.9
    assert inner.sum() > 100 and (miss < 0.02).any()
    forward = 2.0 * miss[inner] - 1.0
    aside = np.sqrt(1.0 - forward**2)
    room = 10.0 * MM
    along = distance + np.where(forward < 0.0, room / aside, room) * forward
    across = np.where(forward < 0.0, room, room * aside)
    square = along**2 + across**2
    lit = np.maximum(along, 0.0) / np.sqrt(square) / np.maximum(square, distance**2)
    own = (0.5 / np.pi * INTENSITY * lit)[:, None] * np.ones(3)
    wall = scene.empty()[inner]
    total, behind = own.sum(axis=1), wall.sum(axis=1)
    mean = 0.6 * total + 0.4 * np.sqrt(total * np.maximum(behind, 0.12 * total))
    around = mean[:, None] * (wall + 0.2 * own) / (behind + 0.2 * total)[:, None]
    reflected = film(np.sqrt(1.0 - miss[inner]))
    expected = around * (reflected * (2.0 - reflected))[:, None]
    added = lit_ - dark
    np.testing.assert_allclose(added[inner], expected, rtol=3e-3, atol=1e-3 * expected.max())
    assert added[miss < 0.1].max() < 1e-2 * added.max()


def test_bubbles_share_a_flat_wall() -> None:
    """Rays through two overlapping bubbles pass three films: the second one is flat."""
    scene = Scene(led=(0.0, -4.0 * MM, 0.0))
    centers = np.array([[0.2, 0.0, 6.0], [0.8, 0.3, 8.0]]) * MM
    radius = np.array([1.6, 1.3]) * MM
    frame = scene.render(FILM, centers, radius)
    first = np.stack(
        [crossing(scene.rays, c, r) for c, r in zip(centers, radius, strict=True)], axis=-1
    )
    known = np.isfinite(first).any(axis=-1)
    nearest = np.where(np.isfinite(first), first, np.inf)
    misses = [scene.miss(c, r) for c, r in zip(centers, radius, strict=True)]
    clear = known & (np.abs(np.array(misses) - 1.0) > 1e-3).all(axis=0)
    seen = frame.foreground_instance.astype(int) - 1000
    np.testing.assert_array_equal(seen[clear], nearest.argmin(axis=-1)[clear])
    depth = nearest.min(axis=-1) * scene.rays[..., 2]
    np.testing.assert_allclose(frame.foreground_depth[clear], depth[clear], rtol=1e-5)
    offset = centers[1] - centers[0]
    distance = np.linalg.norm(offset)
    level = 0.5 * (distance**2 + radius[0] ** 2 - radius[1] ** 2) / distance
    normal = offset / distance
    meets = (level + centers[0] @ normal) / (scene.rays @ normal)
    ends = [
        rays_end(scene.rays, c, r, far)
        for c, r in zip(centers, radius, strict=True)
        for far in (0, 1)
    ]
    both = np.isfinite(first).all(axis=-1) & (meets < ends[1]) & (meets > ends[2])
    assert both.sum() > 200
    passed = 1.0 - film(np.abs(scene.rays @ normal))
    for miss in misses:
        passed = passed * (1.0 - film(np.sqrt(np.maximum(1.0 - miss, 0.0))))
    ratio = (frame.radiance.astype(float) / np.maximum(scene.empty(), 1e-30))[..., 0]
    inner = both & (np.maximum(*misses) < 0.9)
    error = (ratio / passed - 1.0)[inner]
    assert (np.abs(error) < 2e-3).mean() > 0.9 and error.min() > -2e-3  # the rest: LED images
    alone = [
        scene.radiance(FILM, c, r) / np.maximum(scene.empty(), 1e-30)
        for c, r in zip(centers, radius, strict=True)
    ]
    assert np.median((ratio / (alone[0] * alone[1])[..., 0])[inner]) > 1.03


def rays_end(rays: np.ndarray, center: np.ndarray, radius: float, far: int) -> np.ndarray:
    """Distance at which rays enter a sphere that they hit, or leave it if `far` [m]."""
    along = rays @ center
    half = np.sqrt(np.maximum(along**2 - center @ center + radius**2, 0.0))
    return along + half if far else along - half


def test_a_bubble_in_liquid_has_a_rim_and_shade() -> None:
    """Total reflection from 1/n of the radius outwards; less light below a diverging lens."""
    deep = replace(Bubbles(), ripple=0.0, stain=(0.0, 0.0, 0.0), meniscus=2.0 * MM)
    bubbles = replace(deep, border=1.0 - 1.0 / deep.ior)
    scene, radius = Scene(led=(0.0, -4.0 * MM, 0.0)), 1.5 * MM
    center = np.array([0.0, 0.0, 6.0 * MM])
    ratio = (scene.radiance(bubbles, center, radius, 0.5) / scene.empty())[..., 0]
    apart = np.sqrt(scene.miss(center, radius))
    middle = np.median(ratio[apart < 0.1])
    clear = (1.0 - film(np.ones(1))[0]) ** 2
    shade = bubbles.shade * radius / (radius + 0.15 * MM)
    assert middle == pytest.approx(clear * (1.0 - 0.35 * shade), rel=0.03)
    rim = np.median(ratio[(apart > 0.83) & (apart < 0.92)])
    inside = np.median(ratio[(apart > 0.6) & (apart < 0.7)])
    assert rim > 1.1 and inside < middle
    emerged = replace(bubbles, meniscus=0.1 * MM)
    brighter = (scene.radiance(emerged, center, radius, 0.5) / scene.empty())[..., 0]
    assert np.median(brighter[apart < 0.1]) > middle + 0.1
    assert np.median(brighter[(apart > 0.78) & (apart < 0.85)]) < rim - 0.1


def test_the_shade_differs_with_size_and_with_ripple() -> None:
    """Large bubbles darken the wall below more than small ones, unevenly if they have a ripple."""
    scene, center = Scene(240, led=(0.0, -4.0 * MM, 0.0)), np.array([0.0, 0.0, 4.0 * MM])
    even = replace(Bubbles(), ripple=0.0, gleam=0.0, stain=(0.0, 0.0, 0.0))

    def inside(bubbles: Bubbles, radius: float) -> np.ndarray:
        ratio = (scene.radiance(bubbles, center, radius) / scene.empty())[..., 0]
        apart = np.sqrt(scene.miss(center, radius))
        return np.where((apart > 0.4) & (apart < 0.8), ratio, np.nan)

    small, large = (np.nanmedian(inside(even, radius)) for radius in (0.2 * MM, 1.5 * MM))
    assert large < small - 0.1
    uneven = inside(replace(even, ripple=0.22), 1.5 * MM) / inside(even, 1.5 * MM)
    assert np.nanpercentile(uneven, 90) > 1.2 * np.nanpercentile(uneven, 10)


def test_a_bubble_in_liquid_refracts_the_wall_behind_it() -> None:
    """Snell's law at both surfaces turns a ray by 2 (arcsin nb - arcsin b) at b of the radius.

    Geometry remains that of straight rays.
    """
    bubbles = replace(FILM, meniscus=1.0, border=1.0 - 1.0 / FILM.ior)
    look = patterned(np.random.default_rng(2))
    scene, radius = Scene(240, appearance=look), 1.2 * MM
    center = np.array([0.4, 1.0, 6.0]) * MM
    seen = scene.render(bubbles, center, radius)
    apart = np.sqrt(scene.miss(center, radius))
    inside = (apart < 0.7) & (apart > 0.05)
    ray, b = scene.rays[inside], apart[inside]
    aside = unit(ray * (ray @ center)[:, None] - center)
    first, turned = np.arcsin(b), np.arcsin(FILM.ior * b)

    def leaning(angle: np.ndarray) -> np.ndarray:
        """Directions that lean from the ray away from the center."""
        return np.cos(angle)[:, None] * ray + np.sin(angle)[:, None] * aside

    place = center + radius * leaning(2.0 * turned - first)
    heading = leaning(2.0 * (turned - first))
    T = scene.state.T_world_capsule @ scene.camera.T_capsule_camera
    middle = -T[:3, :3].T @ T[:3, 3]
    offset = place - middle
    along = (offset * heading).sum(axis=1)
    way = -along + np.sqrt(along**2 - (offset**2).sum(axis=1) + RADIUS**2)
    point = place + way[:, None] * heading
    slope = scene.rays[..., :2] / scene.rays[..., 2:]
    column, row = ((point[:, :2] / point[:, 2:] - slope[0, 0]) / (slope[1, 1] - slope[0, 0])).T
    known = (np.minimum(row, column) > 0.0) & (np.maximum(row, column) < 239.0)
    known &= point[:, 2] > 0.0
    assert known.sum() > 500
    wall = scene.wall()
    albedo = wall.albedo.astype(float)[..., 0]
    expected = map_coordinates(albedo, [row[known], column[known]], order=1)
    error = np.abs(seen.albedo.astype(float)[inside][known, 0] - expected)
    assert np.median(error) < 2e-3 and (error < 0.02).mean() > 0.95
    assert np.median(np.abs(albedo[inside][known] - expected)) > 0.05
    np.testing.assert_array_equal(seen.depth, wall.depth)


def test_ripple_moves_the_images_of_the_leds_and_keeps_their_mean() -> None:
    """Displacements have the given slope; the area changes by 1 + ∇²η, whose mean is 1."""
    led = np.array([5.0, -7.0, 0.0]) * MM
    scene, radius, ripple = Scene(240, led=tuple(led)), 1.0 * MM, 0.07
    x, y = np.meshgrid(np.arange(-2, 3), np.arange(-2, 3))
    grid = np.stack([2.6 * x.ravel(), 2.6 * y.ravel(), np.full(25, 11.0)], axis=1) * MM
    own = np.stack([scene.miss(c, radius) for c in grid]) < 0.6
    # The image in the front is on the side of the LED, that in the back on the other.
    away = scene.rays / scene.rays[..., 2:] * 11.0 * MM
    own &= np.stack([(away - c) @ (led - c * [1.0, 1.0, 0.0]) > 0.0 for c in grid])
    wall = scene.empty()[..., 0]
    moves, gains = [], []
    for lead in range(3):
        hidden = np.tile([[0.0, 0.0, -9.0 * MM]], (25 * lead, 1))
        centers = np.concatenate([hidden, grid])
        images = []
        for deviation in (0.0, ripple):
            bubbles = replace(FILM, roughness=0.02, ripple=deviation)
            image = scene.radiance(bubbles, centers, radius)[..., 0]
            images.append(np.maximum(image - 1.2 * wall, 0.0))
        for mask in own:
            plain, rippled = (image * mask for image in images)
            place = [(away * i[..., None]).sum(axis=(0, 1)) / i.sum() for i in (plain, rippled)]
            moves.append(np.linalg.norm(place[1] - place[0]) / radius)
            gains.append(rippled.sum() / plain.sum())
    assert np.sqrt(np.mean(np.square(moves))) == pytest.approx(ripple, rel=0.2)
    assert np.mean(gains) == pytest.approx(1.0, abs=0.12)
    assert np.std(gains) > 0.1


@pytest.mark.parametrize("led", [(5.0, -7.0, 0.0), (20.0, -9.0, 2.0)])
def test_only_the_gas_of_a_bubble_in_liquid_mirrors_the_leds(led: tuple[float, ...]) -> None:
    """Images of an LED in a bubble in liquid and in a film differ as Fresnel's reflectances do."""
    light, center, radius = np.array(led) * MM, np.array([1.0, 0.5, 9.0]) * MM, 1.0 * MM
    scene, wet = Scene(240, led=tuple(light)), replace(FILM, meniscus=1.0, border=1e-6)
    place = center
    for _ in range(30):
        place = center + radius * unit(unit(light - place) - unit(place))
    cosine = unit(place - center) @ unit(-place)
    wall = scene.empty()[..., 0]
    film_image, gas_image = (
        scene.radiance(replace(bubbles, roughness=0.02), center, radius)[..., 0] - wall
        for bubbles in (FILM, wet)
    )
    peak = np.linalg.norm(scene.rays - unit(place), axis=-1).argmin()
    assert film_image.flat[peak] > 15.0 * wall.flat[peak]
    surface = fresnel(np.array([cosine]), FILM.ior)
    expected = (surface / film(np.array([cosine])))[0]
    assert gas_image.flat[peak] / film_image.flat[peak] == pytest.approx(expected, rel=0.01)
