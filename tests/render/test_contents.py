"""Spheres and liquid in the image against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import (
    DIRECT,
    RADIUS,
    looking,
    make_camera,
    make_model,
    patterned,
    sphere,
    tube,
)
from tests.support.threads import digests_by_threads
from vrcaps.camera.camera import Led, camera_rays
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Contents, Liquid
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.particles import BUBBLE, WHITE, YELLOW, Spheres
from vrcaps.lumen.pools import Pools
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import State

GEOMETRY = ("depth", "ray_distance", "normal", "label", "instance", "position")
FRONT = ("foreground_label", "foreground_instance", "foreground_depth")
BALL = (1.0 * MM, -2.0 * MM, 9.0 * MM)
CHYME_LABEL = 9
"""Follows the eight octants of the test organs."""


def balls(centers: object, radius: object, kind: int) -> Spheres:
    centers = np.atleast_2d(np.asarray(centers, float))
    count = len(centers)
    return Spheres(
        centers=centers,
        radius=np.broadcast_to(np.asarray(radius, float), count).copy(),
        kind=np.full(count, kind, np.uint8),
        instance=np.arange(1000, 1000 + count).astype(np.uint16),
        color=np.full((count, 3), 0.5),
        arc_length=np.full(count, 0.123),
    )


def filled(state: State, spheres: Spheres, pools: Pools | None = None) -> State:
    return replace(state, lumen_contents=LumenContents(Contents(1, 1, 1), spheres, pools))


@pytest.fixture(scope="module")
def organ() -> OrganSurface:
    return sphere(4)


def crossing(rays: np.ndarray, center: np.ndarray, radius: float) -> np.ndarray:
    """First crossing of rays from the origin with a sphere [m]; NaN where they miss."""
    along = rays @ center
    square = along**2 - center @ center + radius**2
    first = along - np.sqrt(np.maximum(square, 0.0))
    return np.where((square > 0.0) & (first > 0.0), first, np.nan)


@pytest.mark.parametrize("lens", ["pinhole", "equidistant", "scaramuzza"])
def test_a_particle_is_a_surface_in_every_channel(organ: OrganSurface, lens: str) -> None:
    camera = make_camera(lens)
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    T = state.T_world_capsule @ camera.T_capsule_camera
    center = T[:3, :3].T @ (np.array(BALL) - T[:3, 3])
    radius = 2.0 * MM
    seen = renderer.render(
        filled(state, balls(BALL, radius, WHITE)),
        camera,
        channels=(*GEOMETRY, "arc_length", *FRONT),
    )
    empty = renderer.render(state, camera, channels=GEOMETRY)
    rays = camera_rays(camera).astype(float)
    distance = crossing(rays, center, radius)
    mask = np.isfinite(distance)
    assert mask.sum() > 50
    wrong = (seen.label == CHYME_LABEL) != mask
    # Single precision decides otherwise only for rays that graze the ball.
    depth = np.linalg.norm(np.cross(rays, center), axis=-1)
    assert not (wrong & (np.abs(depth - radius) > 1e-6)).any()
    both = mask & ~wrong
    np.testing.assert_allclose(seen.ray_distance[both], distance[both], atol=2e-6)
    np.testing.assert_allclose(seen.depth[both], (distance * rays[..., 2])[both], atol=2e-6)
    normal = (rays * distance[..., None] - center) / radius
    inner = both & (depth < 0.95 * radius)
    np.testing.assert_allclose(seen.normal[inner], normal[inner], atol=2e-3)
    assert (seen.instance[both] == 1000).all()
    np.testing.assert_allclose(seen.arc_length[both], 0.123, rtol=1e-6)
    assert (seen.foreground_label == 0).all() and np.isnan(seen.foreground_depth).all()
    for name in GEOMETRY:
        np.testing.assert_array_equal(getattr(seen, name)[~mask], getattr(empty, name)[~mask])


def test_a_bubble_leaves_the_labels_behind_it(organ: OrganSurface) -> None:
    camera = make_camera("pinhole")
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    radius = 2.5 * MM
    seen = renderer.render(
        filled(state, balls(BALL, radius, BUBBLE)), camera, channels=(*GEOMETRY, *FRONT, "rgb")
    )
    empty = renderer.render(state, camera, channels=(*GEOMETRY, "rgb"))
    for name in GEOMETRY:
        np.testing.assert_array_equal(getattr(seen, name), getattr(empty, name))
    T = state.T_world_capsule @ camera.T_capsule_camera
    center = T[:3, :3].T @ (np.array(BALL) - T[:3, 3])
    rays = camera_rays(camera).astype(float)
    distance = crossing(rays, center, radius)
    off = np.abs(np.linalg.norm(np.cross(rays, center), axis=-1) - radius) > 1e-6
    mask = np.isfinite(distance)
    np.testing.assert_array_equal((seen.foreground_label == 1)[off], mask[off])
    depth = distance * rays[..., 2]
    np.testing.assert_allclose(seen.foreground_depth[mask & off], depth[mask & off], atol=2e-6)
    assert set(np.unique(seen.foreground_instance)) == {0, 1000}
    np.testing.assert_array_equal(seen.rgb[~mask & off], empty.rgb[~mask & off])
    assert (seen.rgb[mask] != empty.rgb[mask]).any()


def test_the_nearest_of_many_spheres_wins(organ: OrganSurface, rng: np.random.Generator) -> None:
    """A hundred particles of all sizes against the smallest crossing of all."""
    camera = make_camera("equidistant")
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    way = rng.standard_normal((300, 3))
    centers = way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(5, 19, (300, 1)) * MM
    radius = rng.uniform(0.05, 1.5, 300) * MM
    seen = renderer.render(filled(state, balls(centers, radius, YELLOW)), camera, channels=GEOMETRY)
    bare = renderer.render(state, camera, channels=("ray_distance",)).ray_distance
    T = state.T_world_capsule @ camera.T_capsule_camera
    rays = camera_rays(camera).astype(float)
    ways = np.stack(
        [crossing(rays, T[:3, :3].T @ c, r) for c, r in zip(centers, radius, strict=True)]
    )
    first = np.where(np.isfinite(ways), ways, np.inf)
    nearest = np.minimum(first.min(axis=0), bare)
    known = np.isfinite(rays[..., 0])
    same = np.abs(seen.ray_distance - nearest)[known] < 3e-6
    assert same.mean() > 0.9995  # rays that graze a sphere may miss it in single precision
    hit = known & (first.min(axis=0) < bare) & (np.abs(seen.ray_distance - nearest) < 3e-6)
    np.testing.assert_array_equal(seen.instance[hit], 1000 + first.argmin(axis=0)[hit])


def test_a_particle_casts_the_shadow_of_a_point_light(organ: OrganSurface) -> None:
    camera = make_camera("pinhole")
    led = Led(position_camera=(6.0 * MM, 0.0, 0.0), lobe_exponent=0.0)
    camera = replace(camera, leds=(led,))
    renderer = Renderer(make_model(organ, camera), RenderSettings(light="direct", shadows=True))
    state = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    radius = 1.0 * MM
    T = state.T_world_capsule @ camera.T_capsule_camera
    center = T[:3, :3] @ np.array([1.0 * MM, 0.0, 8.0 * MM])
    seen = renderer.render(
        filled(state, balls(center, radius, WHITE)),
        camera,
        channels=("radiance", "position", "label"),
    )
    light = T[:3, :3] @ np.array(led.position_camera)
    way = seen.position - light
    unit = way / np.linalg.norm(way, axis=-1, keepdims=True)
    miss = np.linalg.norm(np.cross(center - light, unit), axis=-1)
    wall = seen.label != CHYME_LABEL
    dark = (seen.radiance == 0.0).all(axis=-1)
    assert (dark & wall).sum() > 20
    clear = np.abs(miss - radius) > 2e-5
    np.testing.assert_array_equal(dark[wall & clear], (miss < radius)[wall & clear])


def pool(organ: OrganSurface, level: float) -> Pools:
    return Pools(
        levels=np.array([level]),
        of_vertex=np.ones(len(organ.vertices), np.uint16),
        stretch=np.array([[0.0, 1.0]]),
        volume=np.ones(1),
    )


@pytest.mark.parametrize("level", [-6.0 * MM, 4.0 * MM])
def test_liquid_begins_at_its_level(organ: OrganSurface, level: float) -> None:
    """From above a ray enters where it meets the level; an eye under it is in the liquid."""
    camera = make_camera("equidistant")
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0), (0.6, 0.0, -0.8))
    spheres = balls(np.zeros((0, 3)), np.zeros(0), WHITE)
    full = filled(state, spheres, pool(organ, level))
    seen = renderer.render(full, camera, channels=(*GEOMETRY, *FRONT, "refraction_label"))
    empty = renderer.render(state, camera, channels=GEOMETRY)
    straight = seen.refraction_label == 0
    for name in GEOMETRY:
        expected = getattr(empty, name)[straight]
        np.testing.assert_array_equal(getattr(seen, name)[straight], expected)
    known = np.isfinite(seen.depth)
    if level > 0.0:
        assert (seen.foreground_label[known] == 2).all() and (
            seen.foreground_depth[known] == 0.0
        ).all()
        return
    below = known & (empty.position[..., 2] < level)
    np.testing.assert_array_equal(seen.foreground_label[known] == 2, below[known])
    # Similar triangles: the crossing divides a straight depth as the level divides the drop.
    share = level / empty.position[..., 2]
    np.testing.assert_allclose(
        seen.foreground_depth[below], (share * empty.depth)[below], rtol=1e-4, atol=1e-6
    )


def test_clear_liquid_dims_by_its_absorption(organ: OrganSurface) -> None:
    """Immersed in liquid that only absorbs, light loses exp(−a·(way out + way back))."""
    camera = make_camera("pinhole")
    camera = replace(camera, leds=(Led((0.0, 0.0, 0.0), lobe_exponent=0.0),))
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    absorption = (20.0, 60.0, 150.0)
    liquid = Liquid(absorption=absorption, scattering=(0.0, 0.0, 0.0))
    spheres = balls(np.zeros((0, 3)), np.zeros(0), WHITE)
    lumen_contents = LumenContents(Contents(liquid=liquid), spheres, pool(organ, 1.0))
    wet = renderer.render(
        replace(state, lumen_contents=lumen_contents), camera, channels=("radiance",)
    )
    dry = renderer.render(state, camera, channels=("radiance", "ray_distance"))
    known = np.isfinite(dry.ray_distance)
    loss = np.exp(-2.0 * dry.ray_distance[known][:, None] * np.array(absorption))
    np.testing.assert_allclose(wet.radiance[known], dry.radiance[known] * loss, rtol=1e-4)


def test_flow_and_occlusion_of_a_particle_that_moves(organ: OrganSurface) -> None:
    camera = make_camera("pinhole")
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    T = state.T_world_capsule @ camera.T_capsule_camera
    before, after = np.array([[0.0, 0.0, 8.0 * MM]]), np.array([[1.5 * MM, 0.0, 8.0 * MM]])
    now, then = (
        filled(state, balls((T[:3, :3] @ c.T).T, 1.0 * MM, WHITE)) for c in (before, after)
    )
    seen = renderer.render(
        now,
        camera,
        channels=("label", "position", "flow_forward", "flow_backward", "occlusion"),
        state_next=then,
        state_previous=now,
    )
    ball = seen.label == CHYME_LABEL
    moved = seen.position.astype(float) + np.where(ball[..., None], T[:3, 0] * 1.5 * MM, 0.0)
    local = (moved - T[:3, 3]) @ T[:3, :3]
    expected = camera.lens.project(local) - np.stack(
        np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1
    )
    known = np.isfinite(seen.flow_forward).all(axis=-1)
    assert known[ball].all()
    np.testing.assert_allclose(seen.flow_forward[known], expected[known], atol=2e-2)
    np.testing.assert_allclose(seen.flow_backward[known], 0.0, atol=2e-2)
    # The wall that the ball comes to hide is seen now and not then.
    inverse = np.linalg.norm(local, axis=-1, keepdims=True)
    target = np.linalg.norm(np.cross(local / inverse, after[0]), axis=-1)
    hidden = (target < 0.98 * MM) & ~ball & known
    assert hidden.sum() > 20
    assert seen.occlusion[hidden].all()
    assert not seen.occlusion[(target > 1.02 * MM) & ~ball & known].any()


def test_what_is_in_the_capsules_way_is_pushed_aside() -> None:
    spheres = balls([[0.0, 1.0 * MM, 2.0 * MM], [9.0 * MM, 0.0, 0.0]], 1.0 * MM, BUBBLE)
    lumen_contents = LumenContents(Contents(1), spheres)
    moved = lumen_contents.around_capsule(np.eye(4), 24.0 * MM, 5.0 * MM)
    expected = [[0.0, 6.0 * MM, 2.0 * MM], [9.0 * MM, 0.0, 0.0]]
    np.testing.assert_allclose(moved.spheres.centers, expected, atol=1e-12)
    assert moved.around_capsule(np.eye(4), 24.0 * MM, 4.9 * MM) is moved


@pytest.mark.parametrize("ball", [(0.3, 0.2, 0.5), (0.5, 0.4, 2.1)])
def test_a_bubble_at_the_eye(organ: OrganSurface, ball: tuple[float, ...]) -> None:
    """Around the eye it covers every pixel, its far side counts; beside it, its near side."""
    camera = make_camera("pinhole")
    rays = camera_rays(camera).astype(float)
    center, radius = np.array(ball) * MM, 1.2 * MM
    state = looking((0.0, 0.0, 0.0))
    T = state.T_world_capsule @ camera.T_capsule_camera
    placed = filled(state, balls(T[:3, :3] @ center + T[:3, 3], radius, BUBBLE))
    frame = Renderer(make_model(organ, camera), DIRECT).render(
        placed, camera, channels=("radiance", *FRONT)
    )
    along = rays @ center
    square = along**2 - center @ center + radius**2
    root = np.where(square > 0.0, np.sqrt(np.maximum(square, 0.0)), np.nan)
    is_inside = np.linalg.norm(center) < radius
    way = along + root if is_inside else along - root
    known = np.isfinite(way) & (way > 0.0)
    if is_inside:
        assert known.all()
    np.testing.assert_array_equal(frame.foreground_label == 1, known)
    expected = (way * rays[..., 2])[known]
    np.testing.assert_allclose(frame.foreground_depth[known], expected, rtol=1e-4)
    assert np.isfinite(frame.radiance).all()


def test_nothing_in_front_without_contents(organ: OrganSurface) -> None:
    camera = make_camera("pinhole")
    frame = Renderer(make_model(organ, camera), DIRECT).render(
        looking((0.0, 0.0, 0.0)), camera, channels=FRONT
    )
    assert (frame.foreground_label == 0).all() and (frame.foreground_instance == 0).all()
    assert np.isnan(frame.foreground_depth).all()


def digest() -> str:
    """Checksum of a frame with everything in it, with shadows and sub-pixels."""
    import hashlib

    rng = np.random.default_rng(3)
    organ = tube(60, 120, folds=0.3, capped=True, appearance=patterned(rng))
    camera = make_camera("scaramuzza")
    renderer = Renderer(
        make_model(organ, camera), RenderSettings(light="direct", supersampling=2, shadows=True)
    )
    centers = np.column_stack([rng.uniform(-12, 12, (400, 2)), rng.uniform(60, 140, 400)]) * MM
    spheres = balls(centers, rng.uniform(0.2, 2.0, 400) * MM, BUBBLE)
    kind = rng.integers(0, 3, 400).astype(np.uint8)
    state = filled(
        looking((0.0, 0.0, 50.0 * MM)), replace(spheres, kind=kind), pool(organ, 90.0 * MM)
    )
    channels = ("rgb", "radiance", *GEOMETRY, *FRONT)
    frame = renderer.render(state, camera, channels=channels)
    total = hashlib.sha256()
    for name in channels:
        total.update(getattr(frame, name).tobytes())
    return total.hexdigest()


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads() -> None:
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert len(digests) == 1


def test_refuses_spheres_that_are_none(organ: OrganSurface) -> None:
    camera = make_camera("pinhole")
    renderer = Renderer(make_model(organ, camera), DIRECT)
    state = looking((0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="radii above 0"):
        renderer.render(filled(state, balls(BALL, 0.0, WHITE)), camera)
    with pytest.raises(ValueError, match="pool index for each vertex"):
        short = replace(pool(organ, 0.0), of_vertex=np.ones(3, np.uint16))
        renderer.render(filled(state, balls(BALL, RADIUS / 9, WHITE), short), camera)
