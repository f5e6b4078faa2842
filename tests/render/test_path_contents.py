"""Scattered light among what floats in the lumen: closed forms in a hollow sphere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import (
    DIRECT,
    RADIUS,
    looking,
    make_camera,
    make_model,
    pinhole,
    sphere,
    with_ball,
)
from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.core.geometry import rotate_vectors
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Bubbles, Contents, Liquid
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.particles import BUBBLE, WHITE, Spheres
from vrcaps.lumen.pools import Pools
from vrcaps.organ.surface import Appearance, OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import State

CODE, POWER = 200, 1e-3
ALBEDO = ((CODE / 255 + 0.055) / 1.055) ** 2.4
LOOK = Appearance(
    np.full((1, 1, 3), CODE, np.uint8),
    np.full((1, 1), 153, np.uint8),  # as rough as particles
    np.zeros((1, 1)),
    ior=1.0,
    clearcoat=0.0,
    clearcoat_gloss=0.2,
)


def ball(center: tuple[float, float, float], radius: float, kind: int) -> Spheres:
    return Spheres(
        centers=np.array([center]),
        radius=np.array([radius]),
        kind=np.array([kind], np.uint8),
        instance=np.array([1000], np.uint16),
        color=np.full((1, 3), ALBEDO),
        arc_length=np.zeros(1),
    )


def scene(
    eye: tuple[float, float, float], forward: tuple[float, float, float], led: np.ndarray
) -> tuple[Camera, State]:
    """A camera in a hollow sphere, and an even LED at a place in the world."""
    state = looking(eye, forward)
    offset = rotate_vectors(state.T_world_capsule.T, led - np.array(eye))
    lamp = Led(tuple(offset), lobe_exponent=0.0, intensity=(POWER,) * 3)
    return make_camera(pinhole(40, 0.9), leds=(lamp,)), state


def indirect(organ: OrganSurface, camera: Camera, state: State, depth: int = 6) -> np.ndarray:
    """Radiance beyond the first reflection."""
    model = make_model(organ, camera)
    path = RenderSettings(light="path", spp=64, max_bounces=depth)
    direct = replace(path, max_bounces=1)
    both = [
        Renderer(model, s).render(state, camera, channels=("radiance",)).radiance
        for s in (path, direct)
    ]
    return both[0].astype(float) - both[1]


def sphere_light(passes: Callable[[np.ndarray], np.ndarray], first: float, depth: int) -> float:
    """Irradiance of the wall by light after the first reflection, per that of the lamp.

    Of light that leaves a matt wall at an angle θ a share T(θ) gets across, so that each bounce
    leaves ρ ∫ T 2 sin θ cos θ dθ of the one before, everywhere alike. Burley's base is matt but for
    some per cent, which the test's tolerance covers.

    Args:
        passes: T by the sine of the angle.
        first: Share of the lamp's light that gets to the wall.
        depth: Most reflections.
    """
    square = (np.arange(20_000) + 0.5) / 20_000  # sin²θ is even
    each = ALBEDO * passes(np.sqrt(square)).mean()
    return first * sum(each**k for k in range(1, depth))


@pytest.mark.slow
def test_absorbing_liquid_dims_every_bounce() -> None:
    """Immersed: exp(−a · chord) on each way across, exp(−a R) from the lamp, exp(−a d) to the eye.

    Against the same sphere without liquid, so that the base's departure from matt cancels.
    """
    organ = sphere(4, appearance=LOOK)
    camera, dry = scene((0.0, 0.0, -6.0 * MM), (0.2, 0.1, -1.0), np.zeros(3))
    absorption = 25.0
    liquid = Liquid(absorption=(absorption,) * 3, scattering=(0.0,) * 3)
    count = len(organ.vertices)
    pools = Pools(np.array([1.0]), np.ones(count, np.uint16), np.array([[-1.0, 1.0]]), np.ones(1))
    nothing = ball((0.0, 0.0, 0.5), 1e-6, WHITE)
    wet = replace(dry, lumen_contents=LumenContents(Contents(0, 0, liquid), nothing, pools))
    found = indirect(organ, camera, wet).mean() / indirect(organ, camera, dry).mean()

    def through(sine: np.ndarray) -> np.ndarray:
        return np.exp(-absorption * 2.0 * RADIUS * np.sqrt(1.0 - sine**2))

    lamp = np.exp(-absorption * RADIUS)
    clear = sphere_light(np.ones_like, 1.0, 6)
    frame = Renderer(make_model(organ, camera), DIRECT).render(
        dry, camera, channels=("ray_distance",)
    )
    seen = np.exp(-absorption * np.asarray(frame.ray_distance, float)).mean()
    expected = sphere_light(through, lamp, 6) / clear * seen
    assert found == pytest.approx(expected, rel=0.015)


@pytest.mark.slow
def test_a_bubble_takes_its_share_of_every_way() -> None:
    """Each crossing passes 1 − 2F/(1 + F) of the light, F Fresnel's share at its angle."""
    organ, radius, ior = sphere(4, appearance=LOOK), 15.0 * MM, 1.9
    camera, dry = scene((0.0, 0.0, -17.0 * MM), (0.05, 0.1, -1.0), np.zeros(3))
    contents = Contents(Bubbles(per_area=0.0, ior=ior), 0, 0)
    full = replace(
        dry, lumen_contents=LumenContents(contents, ball((0.0, 0.0, 0.0), radius, BUBBLE), None)
    )
    found = indirect(organ, camera, full).mean() / indirect(organ, camera, dry).mean()

    def crossing(sine: np.ndarray) -> np.ndarray:
        c1 = np.sqrt(1.0 - sine**2)
        c2 = np.sqrt(1.0 - (sine / ior) ** 2)
        across, along = (c1 - ior * c2) / (c1 + ior * c2), (ior * c1 - c2) / (ior * c1 + c2)
        share = 0.5 * (across**2 + along**2)
        return 1.0 - 2.0 * share / (1.0 + share)

    def through(sine: np.ndarray) -> np.ndarray:
        apart = sine * RADIUS / radius
        return np.where(apart < 1.0, crossing(np.minimum(apart, 1.0)) ** 2, 1.0)

    lamp = float(crossing(np.zeros(1))[0])
    expected = sphere_light(through, lamp, 6) / sphere_light(np.ones_like, 1.0, 6)
    assert expected < 0.6
    assert found == pytest.approx(expected, rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [4.0 * MM, 9.0 * MM])
def test_a_particle_bounces_light_as_a_ball_of_wall_does(radius: float) -> None:
    """Beside the same ball as part of the wall: its lumps turn some of the light away."""
    organ, center = sphere(4, appearance=LOOK), np.array([4.0, 2.0, 6.0]) * MM
    lamp = np.array([-6.0, 0.0, -4.0]) * MM
    camera, state = scene((-9.0 * MM, 3.0 * MM, -9.0 * MM), (0.4, -0.1, 1.0), lamp)
    nothing = indirect(organ, camera, state)
    lumen_contents = LumenContents(Contents(0, 1, 0), ball(tuple(center), radius, WHITE), None)
    floating = indirect(organ, camera, replace(state, lumen_contents=lumen_contents))
    rigid = indirect(with_ball(organ, center, radius), camera, state)
    rays = camera_rays(camera).astype(float) @ state.T_world_capsule[:3, :3].T
    offset = center - state.T_world_capsule[:3, 3]
    is_ball = np.linalg.norm(np.cross(rays, offset), axis=-1) < 1.03 * radius
    assert is_ball.any() and not is_ball.all()
    for part, tolerance in ((is_ball, 0.06), (~is_ball, 0.03)):
        assert floating[part].mean() == pytest.approx(rigid[part].mean(), rel=tolerance)
    assert abs(floating[~is_ball].mean() / nothing[~is_ball].mean() - 1.0) > 0.02
