"""Particles of a clump have one surface, the same in every channel and for every ray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.clump_twin import ClumpTwin
from tests.support.shapes import DIRECT, looking, make_camera, make_model, pinhole, sphere
from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Contents
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.particles import YELLOW, Spheres
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import State

CHYME_LABEL = 9
"""Follows the eight octants of the test organs."""


@pytest.fixture(scope="module")
def organ() -> OrganSurface:
    return sphere(3)


def clump(centers: np.ndarray, radius: np.ndarray, instance: object = 1000) -> LumenContents:
    count = len(radius)
    spheres = Spheres(
        centers=centers,
        radius=radius,
        kind=np.full(count, YELLOW, np.uint8),
        instance=np.broadcast_to(np.asarray(instance, np.uint16), count).copy(),
        color=np.full((count, 3), 0.3),
        arc_length=np.full(count, 0.1),
    )
    return LumenContents(Contents(0, 1, 0), spheres)


def view(side: int = 40) -> tuple[Camera, State, np.ndarray]:
    """A camera at the origin with an LED in its eye, its state and its rays in the world."""
    led = Led(position_camera=(0.0, 0.0, 0.0), lobe_exponent=0.0)
    camera, state = make_camera(pinhole(side, 0.7), leds=(led,)), looking((0.0, 0.0, 0.0))
    T = state.T_world_capsule @ camera.T_capsule_camera
    return camera, state, camera_rays(camera).astype(float) @ T[:3, :3].T


def heap(rng: np.random.Generator, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twelve particles about 9 mm along an axis."""
    centers = 9.0 * MM * axis + 1.3 * MM * rng.standard_normal((12, 3))
    return centers, rng.uniform(0.5, 1.2, 12) * MM


def test_a_clump_is_one_surface_in_every_channel(
    organ: OrganSurface, rng: np.random.Generator
) -> None:
    """Against the surface in double precision; balls alone would leave gaps and creases."""
    camera, state, rays = view(32)
    centers, radius = heap(rng, rays[16, 16])
    full = replace(state, lumen_contents=clump(centers, radius))
    channels = ("ray_distance", "position", "normal", "label", "instance", "radiance")
    settings = RenderSettings(light="direct", shadows=True)
    seen = Renderer(make_model(organ, camera), settings).render(full, camera, channels=channels)
    twin = ClumpTwin(centers, radius)
    expected = twin.first_hit(rays.reshape(-1, 3), 16.0 * MM).reshape(seen.label.shape)
    is_clump = seen.label == CHYME_LABEL
    assert is_clump.sum() > 100
    # In single precision a ray that grazes the surface may miss it.
    assert (is_clump == np.isfinite(expected)).mean() > 0.998
    both = is_clump & np.isfinite(expected)
    error = np.abs(seen.ray_distance[both] / expected[both] - 1.0)
    assert np.mean(error < 1e-5) > 0.99
    same = both.copy()
    same[both] = error < 1e-5
    T = state.T_world_capsule @ camera.T_capsule_camera
    normal = twin.normal(rays[same] * expected[same][:, None]) @ T[:3, :3]
    np.testing.assert_allclose(seen.normal[same], normal, atol=2e-3)
    assert (seen.instance[both] == 1000).all()
    # The light is in the eye: what is seen is lit, nothing shades itself.
    facing = same.copy()
    facing[same] = -np.sum(normal * (rays[same] @ T[:3, :3]), axis=1) > 0.1
    assert (seen.radiance[facing] > 0.0).all()


def test_a_ray_through_the_neck_of_two_particles_meets_it(organ: OrganSurface) -> None:
    """Two balls that touch leave a groove between them; bound together they have a neck."""
    camera, state, rays = view()
    across = np.cross(rays[20, 20], [0.3, 0.5, 0.2])
    across /= np.linalg.norm(across)
    radius = np.full(2, 1.5 * MM)
    centers = 9.0 * MM * rays[20, 20] + np.outer([-1.0, 1.0], 1.45 * MM * across)
    renderer = Renderer(make_model(organ, camera), DIRECT)

    def label(instance: object) -> np.ndarray:
        contents = clump(centers, radius.copy(), instance)
        return renderer.render(
            replace(state, lumen_contents=contents), camera, channels=("label",)
        ).label

    bound, apart = (label(instance) == CHYME_LABEL for instance in (1000, [1000, 1001]))
    middle = np.abs(rays @ across) < 0.3 * MM / (9.0 * MM)
    assert (bound & middle).sum() > (apart & middle).sum() + 5


@pytest.mark.slow
def test_both_renderers_light_a_clump_alike(organ: OrganSurface, rng: np.random.Generator) -> None:
    camera, state, rays = view(24)
    camera = replace(camera, leds=(Led((3.0 * MM, 0.0, 0.0), lobe_exponent=0.0),))
    full = replace(state, lumen_contents=clump(*heap(rng, rays[12, 12])))
    direct = RenderSettings(light="direct", shadows=True)
    path = RenderSettings(light="path", spp=4, max_bounces=1)
    one, other = (
        Renderer(make_model(organ, camera), s).render(full, camera, channels=("radiance",)).radiance
        for s in (direct, path)
    )
    np.testing.assert_allclose(other.mean(), one.mean(), rtol=1e-3)
