"""Liquid's surfaces against the laws of Snell and Fresnel, and the flow seen through them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.support.shapes import DIRECT, RADIUS, looking, make_camera, make_model, pinhole, sphere
from tests.support.twin_shade import principled
from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.core.units import DEG, MM
from vrcaps.lumen.contents import Contents, Liquid
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.particles import BUBBLE, WHITE, Spheres
from vrcaps.lumen.pools import Pools
from vrcaps.organ.surface import Appearance, OrganSurface
from vrcaps.render.channels import Frame
from vrcaps.render.flow import refract_paths, surface_heights
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import State

IOR = 1.333
LEVEL = -4.0 * MM
STRAIGHT, REFRACTED, REFLECTED = range(3)
CLEAR = Liquid(absorption=(0.0, 0.0, 0.0), scattering=(0.0, 0.0, 0.0))
PLAIN = Appearance(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.uint8), np.zeros((1, 1)))
ALBEDO, ROUGHNESS = np.array([0.52, 0.22, 0.16]), 0.5
"""Refraction in an organ without an appearance."""
CHANNELS = ("ray_distance", "depth", "position", "normal", "refraction_label", "foreground_label")


@pytest.fixture(scope="module")
def organ() -> OrganSurface:
    return sphere(5)


def balls(centers: object = (), radius: float = 1.0, kind: int = WHITE) -> Spheres:
    centers = np.reshape(np.asarray(centers, float), (-1, 3))
    count = len(centers)
    return Spheres(
        centers=centers,
        radius=np.full(count, radius),
        kind=np.full(count, kind, np.uint8),
        instance=np.arange(1000, 1000 + count).astype(np.uint16),
        color=np.full((count, 3), 0.5),
        arc_length=np.full(count, 0.05),
    )


def flooded(
    state: State,
    organ: OrganSurface,
    *,
    level: float = LEVEL,
    liquid: Liquid = CLEAR,
    spheres: Spheres | None = None,
) -> State:
    count = len(organ.vertices)
    pools = Pools(np.array([level]), np.ones(count, np.uint16), np.array([[-1.0, 1.0]]), np.ones(1))
    lumen_contents = LumenContents(Contents(1, 1, liquid), spheres or balls(), pools)
    return replace(state, lumen_contents=lumen_contents)


@dataclass
class Ways:
    """Both pieces of each pixel's way by Snell's law."""

    first: np.ndarray
    turn: np.ndarray
    second: np.ndarray
    cosine: np.ndarray
    eye: np.ndarray

    @classmethod
    def of(cls, camera: Camera, state: State, level: float, ior: float = IOR) -> Ways:
        T = state.T_world_capsule @ camera.T_capsule_camera
        rays = camera_rays(camera).astype(float) @ T[:3, :3].T
        eye = T[:3, 3]
        index = ior if eye[2] >= level else 1.0 / ior
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = eye + rays * ((level - eye[2]) / rays[..., 2:])
            up = np.copysign(np.sqrt(1.0 - (1.0 - rays[..., 2] ** 2) / index**2), rays[..., 2])
        heading = np.concatenate([rays[..., :2] / index, up[..., None]], axis=-1)
        mirrored = rays * [1.0, 1.0, -1.0]
        second = np.where(np.isfinite(up)[..., None], heading, mirrored)
        return cls(rays, turn, second, np.abs(rays[..., 2]), eye)

    def on_sphere(self, heading: np.ndarray) -> np.ndarray:
        """Distance from the turn to the smooth wall."""
        along = (self.turn * heading).sum(axis=-1)
        square = along**2 - (self.turn**2).sum(axis=-1) + RADIUS**2
        return -along + np.sqrt(np.maximum(square, 0.0))


def seen(organ: OrganSurface, camera: Camera, state: State, *channels: str) -> Frame:
    return Renderer(make_model(organ, camera), DIRECT).render(
        state, camera, channels=(*CHANNELS, *channels)
    )


@pytest.mark.parametrize("under", [False, True])
def test_rays_bend_by_snells_law(organ: OrganSurface, under: bool) -> None:
    """sin θ₁ = n sin θ₂; beyond arcsin(1/n) from below all is mirrored."""
    camera = make_camera("equidistant")
    eye, forward = ((0.0, 0.0, -9.0 * MM), 0.9) if under else ((0.0, 0.0, 3.0 * MM), -0.9)
    state = flooded(looking(eye, (0.3, 0.1, forward)), organ)
    frame = seen(organ, camera, state)
    ways = Ways.of(camera, state, LEVEL)
    known = np.isfinite(frame.ray_distance)
    bent = known & (frame.refraction_label != STRAIGHT)
    assert bent.sum() > 500
    length = ways.on_sphere(ways.second)
    expected = ways.turn + length[..., None] * ways.second
    np.testing.assert_allclose(frame.position[bent], expected[bent], atol=0.1 * MM)
    # Exactly on the bent ray, wherever the facets are.
    offset = frame.position.astype(float) - ways.turn
    off_ray = np.linalg.norm(np.cross(offset, ways.second), axis=-1)
    assert off_ray[bent].max() < 3e-7
    total = np.linalg.norm(ways.turn - ways.eye, axis=-1) + (offset * ways.second).sum(axis=-1)
    np.testing.assert_allclose(frame.ray_distance[bent], total[bent], atol=1e-6)
    rays = camera_rays(camera)
    np.testing.assert_allclose(
        frame.depth[known], (frame.ray_distance * rays[..., 2])[known], rtol=1e-6
    )
    assert ((ways.second * ways.first).sum(axis=-1)[bent] < 1.0 + 1e-12).all()
    if not under:
        assert set(np.unique(frame.refraction_label[known])) == {STRAIGHT, REFRACTED}
        assert (frame.position[..., 2][bent] < LEVEL).all()
        return
    rising = known & (ways.first[..., 2] > 0.0)
    slant = np.arccos(ways.cosine[rising & bent])
    clear = np.abs(slant - np.arcsin(1.0 / IOR)) > 1e-4
    beyond = slant > np.arcsin(1.0 / IOR)
    np.testing.assert_array_equal(
        (frame.refraction_label[rising & bent] == REFLECTED)[clear], beyond[clear]
    )
    assert beyond.any() and (~beyond).any()
    above = frame.position[..., 2] > LEVEL
    np.testing.assert_array_equal(above[bent], frame.refraction_label[bent] == REFRACTED)
    assert (frame.foreground_label[known] == 2).all()


def test_apparent_depth_is_the_depth_over_the_index() -> None:
    """Looking straight down, a point d under the surface appears at d/n."""
    eye = np.array([0.0, 0.0, 6.0 * MM])
    points = np.array([[x, 0.0, -9.0 * MM] for x in (1e-6, 1e-5, -2e-5)])
    bends = refract_paths(eye, points, np.zeros(3), np.zeros(3, bool), IOR)
    slope = (bends.apparent[:, 0] - eye[0]) / (eye[2] - bends.apparent[:, 2])
    depth = points[:, 0] / slope - 6.0 * MM
    np.testing.assert_allclose(depth, 9.0 * MM / IOR, rtol=1e-6)
    reach = np.linalg.norm(bends.apparent - eye, axis=-1)
    np.testing.assert_allclose(reach, 15.0 * MM, rtol=1e-6)


@pytest.mark.parametrize("height", [5.0 * MM, -5.0 * MM])
def test_bent_ways_obey_snell(height: float, rng: np.random.Generator) -> None:
    eye = np.array([1.0 * MM, -2.0 * MM, height])
    points = rng.uniform(-30.0 * MM, 30.0 * MM, (500, 3))
    points[:, 2] = -np.sign(height) * rng.uniform(1e-6, 20.0 * MM, 500)
    bends = refract_paths(eye, points, np.zeros(500), np.zeros(500, bool), IOR)
    assert bends.surface_crossing is not None
    np.testing.assert_allclose(bends.surface_crossing[:, 2], 0.0, atol=1e-15)
    sines = []
    for leg in (bends.surface_crossing - eye, points - bends.surface_crossing):
        sines.append(leg[:, :2] / np.linalg.norm(leg, axis=-1, keepdims=True))
    index = (1.0, IOR) if height > 0.0 else (IOR, 1.0)
    np.testing.assert_allclose(sines[0] * index[0], sines[1] * index[1], atol=1e-6)


def test_straight_where_nothing_is_between(organ: OrganSurface) -> None:
    eye = np.array([0.0, 0.0, 5.0 * MM])
    points = np.array([[0.0, 1.0 * MM, 2.0 * MM], [0.0, 0.0, -9.0 * MM], [np.nan] * 3])
    bends = refract_paths(eye, points, np.array([0.0, np.nan, 0.0]), np.ones(3, bool), IOR)
    assert bends.surface_crossing is not None and np.isnan(bends.surface_crossing).all()
    np.testing.assert_array_equal(bends.apparent, points)
    empty = LumenContents(Contents(1), balls(), None)
    wall = make_model(organ, make_camera()).wall
    levels = surface_heights(empty, eye, wall, organ.faces, np.zeros(4, int))
    assert np.isnan(levels).all()


def test_light_through_and_off_a_surface(organ: OrganSurface) -> None:
    """(1 − F) · wall · exp(−a · way) + F · wall in the mirror, away from the LED's own image."""
    led = Led((8.0 * MM, 0.0, 0.0), lobe_exponent=0.0)
    camera = make_camera("equidistant", leds=(led,))
    absorption = np.array([20.0, 60.0, 150.0])
    liquid = replace(CLEAR, absorption=tuple(absorption))
    state = flooded(looking((0.0, 0.0, 2.0 * MM), (0.5, 0.2, -0.6)), organ, liquid=liquid)
    frame = seen(organ, camera, state, "radiance")
    ways = Ways.of(camera, state, LEVEL)
    T = state.T_world_capsule @ camera.T_capsule_camera
    lamp = T[:3, :3] @ np.array(led.position_camera) + T[:3, 3]

    def lit(heading: np.ndarray, bent: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        length = ways.on_sphere(heading)[bent]
        points = ways.turn[bent] + length[:, None] * heading[bent]
        way = lamp - points
        distance = np.linalg.norm(way, axis=-1)
        normal = -points / RADIUS
        count = len(points)
        reflected = principled(
            PLAIN,
            np.broadcast_to(ALBEDO, (count, 3)),
            np.full(count, ROUGHNESS),
            normal,
            -heading[bent],
            way / distance[:, None],
        )
        radiance = reflected * np.array(led.intensity) / distance[:, None] ** 2
        return radiance, length, distance * (LEVEL - points[:, 2]) / np.abs(way[:, 2])

    bent = frame.refraction_label == REFRACTED
    through, length, lamp_way = lit(ways.second, bent)
    mirrored, _, _ = lit(ways.first * [1.0, 1.0, -1.0], bent)
    c1 = ways.cosine[bent]
    c2 = np.abs(ways.second[bent][:, 2])
    across, along = (c1 - IOR * c2) / (c1 + IOR * c2), (IOR * c1 - c2) / (IOR * c1 + c2)
    share = 0.5 * (across**2 + along**2)[:, None]
    left = np.exp(-absorption * (length + lamp_way)[:, None])
    expected = (1.0 - share) * through * left + share * mirrored
    # The mirror image of the LED: where the half vector is near the vertical.
    half = (lamp - ways.turn[bent]) / np.linalg.norm(lamp - ways.turn[bent], axis=-1)[:, None]
    half -= ways.first[bent]
    plain = half[:, 2] / np.linalg.norm(half, axis=-1) < np.cos(6.0 * DEG)
    assert plain.sum() > 500 and (share[plain] > 0.15).any()
    error = np.abs(frame.radiance[bent][plain] / expected[plain] - 1.0)
    assert np.median(error) < 5e-3 and np.quantile(error, 0.98) < 0.05


def test_what_is_mirrored_from_below_is_all_the_light(organ: OrganSurface) -> None:
    """Total reflection in clear liquid: as bright as the wall that the mirrored ray meets."""
    camera = make_camera(pinhole(64, 0.8), leds=(Led((0.0, 0.0, 0.0), lobe_exponent=0.0),))
    state = flooded(looking((-5.0 * MM, 0.0, -9.0 * MM), (1.0, 0.0, 0.3)), organ)
    frame = seen(organ, camera, state, "radiance")
    bent = frame.refraction_label == REFLECTED
    assert bent.sum() > 1000
    ways = Ways.of(camera, state, LEVEL)
    points, eye = frame.position[bent].astype(float), ways.eye
    way = eye - points
    distance = np.linalg.norm(way, axis=-1)
    count = len(points)
    reflected = principled(
        PLAIN,
        np.broadcast_to(ALBEDO, (count, 3)),
        np.full(count, ROUGHNESS),
        -points / np.linalg.norm(points, axis=-1)[:, None],
        -ways.second[bent],
        way / distance[:, None],
    )
    reflected *= np.array(camera.leds[0].intensity)
    error = np.abs(frame.radiance[bent] * distance[:, None] ** 2 / reflected - 1.0)
    assert np.median(error) < 5e-3 and np.quantile(error, 0.98) < 0.05


def test_an_index_near_one_bends_nothing(organ: OrganSurface) -> None:
    camera = make_camera("equidistant")
    state = looking((0.0, 0.0, 3.0 * MM), (0.3, 0.1, -0.9))
    dry = seen(organ, camera, state)
    wet = seen(organ, camera, flooded(state, organ, liquid=replace(CLEAR, ior=1.0 + 1e-6)))
    assert (wet.refraction_label == REFRACTED).any()
    known = np.isfinite(dry.depth)
    for name in ("depth", "ray_distance", "position"):
        expected, got = getattr(dry, name)[known], getattr(wet, name)[known]
        np.testing.assert_allclose(got, expected, atol=2e-6)


@pytest.mark.parametrize("eye", [(0.0, 0.0, 2.0 * MM), (-4.0 * MM, 0.0, -9.0 * MM)])
def test_flow_through_a_surface(organ: OrganSurface, eye: tuple[float, float, float]) -> None:
    """The pixel that flow points to sees the same point of the wall, the same way."""
    camera = make_camera("equidistant")
    forward = (0.4, 0.1, -0.5 if eye[2] > LEVEL else 0.4)
    now = flooded(looking(eye, forward), organ)
    moved = (eye[0] + 0.6 * MM, eye[1] - 0.4 * MM, eye[2] + 0.3 * MM)
    then = flooded(looking(moved, (forward[0], forward[1] + 0.05, forward[2])), organ)
    renderer = Renderer(make_model(organ, camera), DIRECT)
    channels = (*CHANNELS, "flow_forward", "flow_backward", "occlusion")
    frame = renderer.render(now, camera, channels=channels, state_next=then, state_previous=now)
    following = renderer.render(then, camera, channels=CHANNELS)
    bent = np.isfinite(frame.depth) & (frame.refraction_label != STRAIGHT)
    np.testing.assert_allclose(frame.flow_backward[bent], 0.0, atol=3e-3)
    rows, columns = np.nonzero(bent & ~frame.occlusion)
    assert len(rows) > 1000
    target = frame.flow_forward[rows, columns] + np.column_stack([columns, rows])
    column, row = np.floor(target).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < 79) & (row < 79)
    kinds = np.stack(
        [
            following.refraction_label[np.clip(row + y, 0, 79), np.clip(column + x, 0, 79)]
            for y in (0, 1)
            for x in (0, 1)
        ]
    )
    same = inside & (kinds == frame.refraction_label[rows, columns]).all(axis=0)
    assert same.mean() > 0.7
    row, column = row[same], column[same]
    u, v = (target[same] - np.column_stack([column, row])).T[..., None]
    at = following.position.astype(float)
    found = (at[row, column] * (1 - u) + at[row, column + 1] * u) * (1 - v) + (
        at[row + 1, column] * (1 - u) + at[row + 1, column + 1] * u
    ) * v
    error = np.linalg.norm(found - frame.position[rows[same], columns[same]], axis=-1)
    assert np.median(error) < 0.02 * MM and np.quantile(error, 0.99) < 0.2 * MM


def test_a_ball_in_liquid_is_seen_where_snell_has_it(organ: OrganSurface) -> None:
    """A particle is a surface at its bent place; a bubble shows there and hides behind liquid."""
    camera = make_camera(pinhole(96, 1.2))
    state = looking((0.0, 0.0, 2.0 * MM), (0.8, 0.0, -0.7))
    center, radius = np.array([9.0, 0.0, -9.0]) * MM, 1.0 * MM
    ways = Ways.of(camera, state, LEVEL)
    offset = center - ways.turn
    miss = np.linalg.norm(np.cross(offset, ways.second), axis=-1)
    inside, clear = miss < radius, np.abs(miss - radius) > 2e-6
    wet = flooded(state, organ, spheres=balls(center, radius))
    frame = seen(organ, camera, wet, "instance", "foreground_depth")
    assert inside.sum() > 30
    np.testing.assert_array_equal((frame.instance == 1000)[clear], inside[clear])
    on_ball = np.linalg.norm(frame.position - center, axis=-1)[inside & clear]
    np.testing.assert_allclose(on_ball, radius, atol=1e-6)
    crossing = ((LEVEL - ways.eye[2]) / ways.first[..., 2]) * camera_rays(camera)[..., 2]
    np.testing.assert_allclose(frame.foreground_depth[inside], crossing[inside], rtol=1e-5)
    bare = seen(organ, camera, flooded(state, organ), "radiance")
    gas = flooded(state, organ, spheres=balls(center, radius, BUBBLE))
    bubbly = seen(organ, camera, gas, "radiance")
    differs = (np.abs(bubbly.radiance - bare.radiance) > 1e-6).any(axis=-1)
    assert not differs[~inside & clear].any()
    assert differs[inside].mean() > 0.9
    assert (bubbly.foreground_label[inside] == 2).all()
    np.testing.assert_array_equal(bubbly.position, bare.position)


def test_radiosity_and_paths_come_through(organ: OrganSurface) -> None:
    """Light beyond the first reflection is there in the pool, and finite."""
    camera = make_camera("equidistant")
    state = flooded(looking((0.0, 0.0, 2.0 * MM), (0.5, 0.2, -0.6)), organ)
    model = make_model(organ, camera)
    for settings in (RenderSettings(light="radiosity"), RenderSettings(light="path", spp=2)):
        bright = Renderer(model, settings).render(state, camera, channels=("radiance",)).radiance
        direct = Renderer(model, DIRECT).render(
            state, camera, channels=("radiance", "refraction_label")
        )
        bent = direct.refraction_label == REFRACTED
        assert np.isfinite(bright).all()
        assert bright[bent].mean() > 1.1 * direct.radiance[bent].mean()


def test_free_ways_need_pairs(organ: OrganSurface) -> None:
    model = make_model(organ, make_camera())
    state = flooded(looking((0.0, 0.0, 0.0)), organ, spheres=balls((0.0, 0.0, 5.0 * MM), 1.0 * MM))
    renderer = Renderer(model, DIRECT)
    contents = renderer._core_contents(state.lumen_contents, model.wall, "now")
    starts = np.zeros((3, 3))
    points = np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 3.0], [0.0, 0.0, -30.0]]) * MM
    np.testing.assert_array_equal(
        contents.segments_unoccluded(model.wall, starts, points), [False, True, False]
    )
    with pytest.raises(ValueError, match="as many starts as points"):
        contents.segments_unoccluded(model.wall, starts[:2], points)
