"""Motion of floating contents, its reaction on the capsule, and resumption to the same bytes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.support.threads import digests_by_threads
from tests.support.tubes import straight_gut
from vrcaps import _core
from vrcaps.capsule.device import homogeneous_body
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Bubbles, Contents, Liquid
from vrcaps.lumen.particles import BUBBLE, WHITE, Spheres
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import GRAVITY, Control
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

RADIUS = 25.0 * MM
LEVEL = 12.0 * MM
WATER, VISCOSITY = 1000.0, 1.0e-3


@dataclass(frozen=True)
class Laws:
    liquid_density: float = WATER
    viscosity: float = VISCOSITY
    chyme_density: float = 1050.0
    burst_rate: float = 0.0
    landing_rate: float = 0.0
    release_rate: float = 0.0
    drift: float = 0.0
    reach: float = 1.0
    seed: int = 0


@dataclass(frozen=True)
class Around:
    up: tuple[float, ...] = (0.0, 0.0, 1.0)
    gravity: float = GRAVITY
    stretch: object = None
    levels: object = None
    axis: tuple[tuple[float, ...], ...] = ((0.0, 0.0, -0.9), (0.0, 0.0, -0.91))
    radius: float = 5.0 * MM
    mass: float = 4e-3
    center: tuple[float, ...] = (0.0, 0.0, -0.9)
    wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    velocity: tuple[float, ...] = (0.0, 0.0, 0.0)
    spin: tuple[float, ...] = (0.0, 0.0, 0.0)


THIN = {"liquid_density": 1.0, "viscosity": 1e-9}
"""A liquid that hardly resists."""
FULL = Around(stretch=np.array([[-1.0, 9.0]]), levels=np.array([LEVEL]))
DRY = Around(stretch=np.zeros((0, 2)), levels=np.zeros(0))


@pytest.fixture(scope="module")
def gut() -> OrganSurface:
    return straight_gut({"colon": 0.2}, radius=RADIUS, edge=4.0 * MM)


def swarm_of(
    gut: OrganSurface, centers: object, radius: object, kind: int, **laws: float
) -> tuple[_core.Particles, _core.Wall]:
    """Spheres at places about the middle of the gut."""
    wall = _core.Wall(gut.vertices, gut.faces.astype(np.int64))
    centers = np.atleast_2d(np.asarray(centers, float)) + np.array(wall.center)
    count = len(centers)
    spheres = Spheres(
        centers,
        np.broadcast_to(np.asarray(radius, float), count).copy(),
        np.full(count, kind, np.uint8),
        np.ones(count, np.uint16),
        np.ones((count, 3)),
        centers[:, 0].copy(),
    )
    tangents = np.tile([1.0, 0.0, 0.0], (3, 1))
    return _core.Particles(wall, spheres, Laws(**laws), tangents, 0.1), wall


@pytest.mark.parametrize("radius", [5e-6, 20e-6])
def test_stokes_law(radius: float) -> None:
    """Small spheres sink at 2/9 Δρ g r² / μ; the drag's correction there is known too."""
    stokes = 2.0 / 9.0 * (1050.0 - WATER) * GRAVITY * radius**2 / VISCOSITY
    speed = -_core.terminal_speed(radius, 1050.0, WATER, VISCOSITY, GRAVITY)
    reynolds = 2.0 * WATER * speed * radius / VISCOSITY
    assert speed == pytest.approx(stokes / (1.0 + 0.15 * reynolds**0.687), rel=1e-5)


@pytest.mark.parametrize("radius", [0.1 * MM, 0.4 * MM, 1.0 * MM, 3.0 * MM])
@pytest.mark.parametrize("density", [1.2, 1050.0])
def test_drag_balances_buoyancy(radius: float, density: float) -> None:
    speed = _core.terminal_speed(radius, density, WATER, VISCOSITY, GRAVITY)
    assert (speed > 0.0) == (density < WATER)
    reynolds = 2.0 * WATER * abs(speed) * radius / VISCOSITY
    coefficient = max(24.0 / reynolds * (1.0 + 0.15 * reynolds**0.687), 0.44)
    drag = 0.5 * coefficient * WATER * np.pi * radius**2 * speed**2
    weight = 4.0 / 3.0 * np.pi * radius**3 * abs(density - WATER) * GRAVITY
    assert drag == pytest.approx(weight, rel=1e-5)


def test_bubbles_rise_and_particles_sink_at_their_speed(gut: OrganSurface) -> None:
    for kind, density, steps in ((BUBBLE, 1.2, 40), (WHITE, 1050.0, 120)):
        swarm, wall = swarm_of(gut, (0.0, 0.0, 0.0), 0.3 * MM, kind)
        for _ in range(steps):
            swarm.step(wall, FULL, 2.5e-3)
        speed = _core.terminal_speed(0.3 * MM, density, WATER, VISCOSITY, GRAVITY)
        assert swarm.states[0, 5] == pytest.approx(speed, rel=1e-3)
        for _ in range(2000):
            swarm.step(wall, FULL, 2.5e-3)
        height = swarm.states[0, 2]
        if kind == BUBBLE:
            assert height == pytest.approx(LEVEL, abs=0.02 * MM)
        else:
            assert -RADIUS < height < -0.95 * RADIUS


def test_drift_carries_along_the_gut(gut: OrganSurface) -> None:
    swarm, wall = swarm_of(gut, (0.0, 0.0, LEVEL), 0.5 * MM, BUBBLE, drift=2.0 * MM)
    before = swarm.states[0]
    for _ in range(400):
        swarm.step(wall, FULL, 2.5e-3)
    after = swarm.states[0]
    assert after[0] - before[0] == pytest.approx(2.0 * MM, rel=0.03)
    assert after[6] - before[6] == pytest.approx(2.0 * MM, rel=0.03)


def test_dry_spheres_stay_where_they_cling(gut: OrganSurface) -> None:
    swarm, wall = swarm_of(gut, [(0.0, 0.0, 24.5 * MM), (0.01, 0.02, 0.0)], 0.5 * MM, WHITE)
    before = swarm.states
    for _ in range(50):
        swarm.step(wall, DRY, 2.5e-3)
    np.testing.assert_allclose(swarm.states[:, :3], before[:, :3], atol=1e-7)


def test_pushing_keeps_momentum(gut: OrganSurface, rng: np.random.Generator) -> None:
    """A capsule plows into a crowd: it gets the opposite of what the spheres get, exactly."""
    centers = rng.uniform(-1, 1, (60, 3)) * [4 * MM, 3 * MM, 3 * MM] + [6.5 * MM, 0, 0]
    swarm, wall = swarm_of(gut, centers, rng.uniform(0.3, 1.0, 60) * MM, WHITE)
    still = replace(FULL, gravity=0.0)
    around = replace(
        still,
        axis=((-5.0 * MM, 0.0, 0.0), (2.0 * MM, 0.0, 0.0)),
        center=(-1.5 * MM, 0.0, 0.0),
        velocity=(0.05, 0.0, 0.0),
    )
    mass = np.array(swarm.masses())[:, None]
    before = (mass * swarm.states[:, 3:6]).sum(axis=0)
    impulse, moment = swarm.step(wall, around, 1e-3)
    gained = (mass * swarm.states[:, 3:6]).sum(axis=0) - before
    assert gained[0] > 0.0
    np.testing.assert_allclose(np.array(impulse) + gained, 0.0, atol=1e-12 * gained[0])
    assert np.isfinite(moment).all()
    feet = np.clip(swarm.states[:, 0], -5.0 * MM, 2.0 * MM)
    away = swarm.states[:, :3] - np.stack([feet, 0 * feet, 0 * feet], 1)
    assert (np.linalg.norm(away, axis=1) > 5.0 * MM).all()


def test_particles_push_one_another_and_keep_momentum(gut: OrganSurface) -> None:
    """A row of four in weightless liquid: the first runs into the second, which pushes the rest."""
    radius, still = 0.5 * MM, replace(FULL, gravity=0.0)
    gap = 2.2 * radius
    swarm, wall = swarm_of(gut, [(k * gap, 0.0, 0.0) for k in range(4)], radius, WHITE, **THIN)
    states = swarm.states
    states[0, 3] = 0.1
    swarm.states = states
    mass = np.array(swarm.masses())
    before = mass @ swarm.states[:, 3:6]
    for _ in range(80):
        swarm.step(wall, still, 5e-4)
    after = swarm.states
    np.testing.assert_allclose(mass @ after[:, 3:6], before, rtol=1e-3, atol=1e-9 * before[0])
    assert (np.diff(after[:, 0]) > 1.99 * radius).all()
    assert after[3, 0] > 3.0 * gap + 0.2 * MM


def test_a_clump_at_rest_stays_as_it_was_put(gut: OrganSurface, rng: np.random.Generator) -> None:
    """Its particles overlap; only what comes nearer than that is pushed."""
    swarm, wall = swarm_of(gut, 0.4 * MM * rng.normal(size=(20, 3)), 0.5 * MM, WHITE, **THIN)
    before = swarm.states
    for _ in range(10):
        swarm.step(wall, replace(FULL, gravity=0.0), 1e-3)
    np.testing.assert_array_equal(swarm.states[:, :3], before[:, :3])


def test_only_what_is_near_moves(gut: OrganSurface) -> None:
    swarm, wall = swarm_of(
        gut, [(0.0, 0.0, 0.0), (0.05, 0.0, 0.0)], 0.3 * MM, BUBBLE, reach=20.0 * MM
    )
    axis = ((-2.0 * MM, 0.0, 0.0), (2.0 * MM, 8.0 * MM, 0.0))
    swarm.step(wall, replace(FULL, axis=axis), 1e-3)
    moved = np.linalg.norm(swarm.states[:, 3:6], axis=1)
    assert moved[0] > 0.0 and moved[1] == 0.0


def test_bubbles_burst_at_their_rate(gut: OrganSurface) -> None:
    centers = np.random.default_rng(0).uniform(-5, 5, (400, 3)) * MM
    swarm, wall = swarm_of(gut, centers, 0.2 * MM, BUBBLE, burst_rate=2.0)
    home = swarm.states
    back = 0
    for _ in range(40):
        before = swarm.states[:, 2]
        swarm.step(wall, FULL, 5e-3)
        back += int((swarm.states[:, 2] < before).sum())
    expected = 400 * 40 * 2.0 * 5e-3
    assert abs(back - expected) < 5.0 * np.sqrt(expected) + 10.0
    assert np.isfinite(swarm.states).all() and len(home) == 400


AHEAD = replace(
    FULL,
    axis=((-8.0 * MM, 0.0, 0.0), (0.0, 0.0, 0.0)),
    center=(-4.0 * MM, 0.0, 0.0),
    velocity=(0.05, 0.01, 0.0),
    spin=(0.0, 2.0, 1.0),
)
"""A capsule whose round end, at the middle of the gut, goes along it and turns."""


def test_a_bubble_that_lands_rides_with_the_capsule(gut: OrganSurface) -> None:
    """Momentum is kept in landing; then the bubble is where the capsule's frame puts it."""
    swarm, wall = swarm_of(gut, (5.5 * MM, 0.5 * MM, 0.2 * MM), 0.7 * MM, BUBBLE, landing_rate=1e9)
    around, mass = replace(AHEAD, gravity=0.0), swarm.masses()[0]
    impulse, _ = swarm.step(wall, around, 1e-9)
    np.testing.assert_allclose(impulse[0], -0.05 * mass, rtol=1e-2)
    seat = swarm.states[0, 7:]
    assert np.linalg.norm(seat - [4.0 * MM, 0.0, 0.0]) == pytest.approx(5.7 * MM, rel=1e-6)
    turn = 0.3
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    center = np.array([10.0 * MM, 3.0 * MM, 0.0])
    ends = center + np.array([[-4.0 * MM, 0.0, 0.0], [4.0 * MM, 0.0, 0.0]]) @ rotation.T
    wxyz = (float(np.cos(turn / 2)), 0.0, 0.0, float(np.sin(turn / 2)))
    moved = replace(around, axis=tuple(map(tuple, ends)), center=tuple(center), wxyz=wxyz)
    swarm.step(wall, moved, 2.5e-3)
    np.testing.assert_allclose(swarm.states[0, :3], center + rotation @ seat, atol=1e-15)
    np.testing.assert_array_equal(swarm.states[0, 7:], seat)
    lever = rotation @ seat
    expected = np.array(around.velocity) + np.cross(around.spin, lever)
    np.testing.assert_allclose(swarm.states[0, 3:6], expected, atol=1e-12)


def test_particles_and_the_capsules_side_hold_no_bubble(gut: OrganSurface) -> None:
    side = (-4.0 * MM, 5.5 * MM, 0.0)
    for kind, place in ((WHITE, (5.5 * MM, 0.0, 0.0)), (BUBBLE, side)):
        swarm, wall = swarm_of(gut, place, 0.7 * MM, kind, landing_rate=1e9)
        swarm.step(wall, AHEAD, 1e-3)
        assert (swarm.states[0, 7:] == 0.0).all()


def test_riding_bubbles_let_go_at_their_rate_and_burst_at_theirs(gut: OrganSurface) -> None:
    """Of n attached bubbles, n (1 − rate dt)^k remain after k steps; none detaches when dry."""
    way = np.random.default_rng(2).standard_normal((600, 3))
    way[:, 0] = np.abs(way[:, 0]) + 0.1
    places = 5.6 * MM * way / np.linalg.norm(way, axis=1, keepdims=True)
    still = replace(FULL, axis=AHEAD.axis, center=AHEAD.center, gravity=0.0)
    for around, rates, left in (
        (still, {"release_rate": 4.0}, 600 * 0.98**20),
        (still, {"burst_rate": 4.0}, 600 * 0.98**20),
        (replace(DRY, axis=AHEAD.axis, center=AHEAD.center), {"release_rate": 4.0}, 600),
    ):
        swarm, wall = swarm_of(gut, places, 0.7 * MM, BUBBLE, **rates)
        floats = swarm.states
        floats[:, 7:] = floats[:, :3] - around.center
        swarm.states = floats
        for _ in range(20):
            swarm.step(wall, around, 5e-3)
        rides = (swarm.states[:, 7:] != 0.0).any(axis=1).sum()
        assert abs(rides - left) <= 5.0 * np.sqrt(left * (1.0 - left / 600))


def test_the_wall_wipes_a_bubble_off(gut: OrganSurface) -> None:
    swarm, wall = swarm_of(gut, (5.6 * MM, 0.0, 0.0), 0.7 * MM, BUBBLE)
    floats = swarm.states
    floats[:, 7:] = (0.0, 0.0, -5.6 * MM)
    swarm.states = floats
    low = (0.0, 0.0, -RADIUS + 5.0 * MM)
    swarm.step(wall, replace(DRY, axis=(low, low), center=low), 2.5e-3)
    assert (swarm.states[0, 7:] == 0.0).all() and swarm.states[0, 2] > -RADIUS


def test_a_sweep_moves_what_is_far_as_single_steps_do(gut: OrganSurface) -> None:
    """Drift is the same to rounding; what is beside the capsule moves in every piece."""
    places = [(30.0 * MM, 0.0, LEVEL), (0.0, 6.0 * MM, LEVEL)]
    around = replace(FULL, axis=AHEAD.axis, gravity=0.0)
    laws = {"drift": 1.0 * MM}
    (single, wall), (swept, _) = (swarm_of(gut, places, 0.5 * MM, BUBBLE, **laws) for _ in "12")
    for piece in range(8):
        single.step(wall, around, 2.5e-3)
        before = swept.states
        swept.step(wall, around, 2.5e-3, 20e-3 if piece == 7 else 0.0)
        moved = swept.states[:, 0] - before[:, 0]
        assert (moved[0] > 0.0) == (piece == 7)
    np.testing.assert_allclose(swept.states[:, :3], single.states[:, :3], atol=20e-3 * 1.0 * MM)


def world_in(gut: OrganSurface, contents: Contents, z: float = 0.0, **device: float) -> World:
    mirocam = replace(read_device("mirocam"), **device)
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = [0.1, 0.0, z]
    model = Model(gut, mirocam, np.eye(4), contents)
    return World(model, Tissue(deformation=None), State(0.0, pose), substep=5e-4)


@pytest.mark.slow
def test_a_light_capsule_floats_at_its_draught(gut: OrganSurface) -> None:
    """At rest the liquid displaced weighs as much as the capsule: of a lying one, the height of
    the chord is where the submerged share is the ratio of densities."""
    contents = Contents(liquid=Liquid(fill=0.45, density=WATER))
    device = read_device("mirocam")
    body = homogeneous_body(device)
    whole = np.pi * body.radius**2 * (2.0 * body.half_axis + 4.0 / 3.0 * body.radius)
    world = world_in(gut, contents, mass=0.5 * WATER * whole)
    pools = world.state.lumen_contents.pools
    assert pools is not None
    level = float(pools.levels[len(pools.levels) // 2])
    height = []
    for _ in range(150):
        world.step(Control(), 1.0 / 30.0)
        height.append(world.state.T_world_capsule[2, 3])
    assert np.mean(height[-60:]) == pytest.approx(level, abs=0.3 * MM)


def test_a_heavy_capsule_rests_on_the_floor_lighter_by_its_liquid(gut: OrganSurface) -> None:
    contents = Contents(liquid=Liquid(fill=0.6, density=WATER))
    start = -RADIUS + 5.6 * MM
    world = world_in(gut, contents, start)
    body = world.body
    whole = np.pi * body.radius**2 * (2.0 * body.half_axis + 4.0 / 3.0 * body.radius)
    assert body.mass > WATER * whole
    forces = []
    for _ in range(60):
        world.step(Control(), 1.0 / 30.0)
        contact = world.state.contact
        assert contact is not None
        forces.append(contact.force_world[2])
    expected = (body.mass - WATER * whole) * GRAVITY
    assert np.mean(forces[-20:]) == pytest.approx(expected, rel=0.02)


def crowded(gut: OrganSurface) -> World:
    bubbles = Bubbles(per_area=1e4, burst_rate=0.5)
    return world_in(gut, Contents(bubbles=bubbles, chyme=2, liquid=3, seed=4), -15.0 * MM)


def digest() -> str:
    world = crowded(straight_gut({"colon": 0.2}, radius=RADIUS, edge=4.0 * MM))
    for _ in range(5):
        world.step(Control(force_world=(0.02, 0.0, 0.0)), 0.02)
    return world.snapshot().contents.tobytes().hex()[-400:]


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads() -> None:
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert len(digests) == 1


def test_restored_world_goes_on_to_the_same_bytes(gut: OrganSurface) -> None:
    world = crowded(gut)
    control = Control(force_world=(0.02, 0.0, 0.0))
    world.step(control, 0.02)
    middle = world.snapshot()
    world.step(control, 0.05)
    end = world.snapshot()
    other = crowded(gut)
    other.restore(middle)
    other.step(control, 0.05)
    for name, value in vars(other.snapshot()).items():
        np.testing.assert_array_equal(value, vars(end)[name])
    lumen_contents = world.state.lumen_contents
    assert lumen_contents is not None and np.isfinite(lumen_contents.spheres.centers).all()


def test_bubbles_on_the_domes_ride_in_a_world_and_are_restored(gut: OrganSurface) -> None:
    def begin() -> World:
        bubbles = Bubbles(per_area=1e4, on_dome=5, burst_rate=0.0, landing_rate=50.0)
        return world_in(gut, Contents(bubbles=bubbles, liquid=3, seed=2), 0.0)

    world, control = begin(), Control(force_world=(0.01, 0.0, 0.0))
    dome_sites = world.model.lumen_contents.dome_sites
    assert len(dome_sites) == 10
    middle = world.snapshot()
    for count in range(3):
        state = world.state
        centers = state.lumen_contents.spheres.centers[-10:]
        local = (centers - state.T_world_capsule[:3, 3]) @ state.T_world_capsule[:3, :3]
        np.testing.assert_allclose(local, dome_sites, atol=1e-12)
        if count == 1:
            middle = world.snapshot()
        world.step(control, 0.03)
    other = begin()
    other.restore(middle)
    for _ in range(2):
        other.step(control, 0.03)
    for name, value in vars(other.snapshot()).items():
        np.testing.assert_array_equal(value, vars(world.snapshot())[name])


def test_rejects_a_snapshot_of_other_contents(gut: OrganSurface) -> None:
    world = crowded(gut)
    with pytest.raises(InputError, match="snapshot's contents has the shape"):
        world.restore(replace(world.snapshot(), contents=np.zeros(3)))


def test_liquid_follows_the_moving_wall(gut: OrganSurface) -> None:
    """Gas goes: the lumen is narrower, the same liquid stands higher in it, and comes back."""

    def begin() -> World:
        return world_in(gut, Contents(liquid=3), 0.0)

    world, pools = begin(), []
    for factor in (1.0, 0.9, 0.8, 0.8, 0.9, 1.0):
        world.step(Control(insufflation=factor), 0.01)
        if factor == 0.9:
            middle = world.snapshot()
        lumen_contents = world.state.lumen_contents
        assert lumen_contents is not None and lumen_contents.pools is not None
        pools.append(lumen_contents.pools)
    volumes = [pool.volume.sum() for pool in pools]
    np.testing.assert_allclose(volumes, volumes[0], rtol=1e-3)
    share = [
        pool.levels.mean() / (factor * RADIUS)
        for pool, factor in zip(pools, (1, 0.9, 0.8), strict=False)
    ]
    assert share[0] < share[1] - 0.05 < share[2] - 0.1
    assert pools[3] is pools[2]
    np.testing.assert_allclose(pools[-1].levels, pools[0].levels, atol=0.05 * RADIUS)
    other = begin()
    other.restore(middle)
    other.step(Control(insufflation=1.0), 0.01)
    np.testing.assert_array_equal(other.snapshot().contents, world.snapshot().contents)
    np.testing.assert_array_equal(other.state.lumen_contents.pools.levels, pools[-1].levels)


def test_posture_takes_the_liquid_along(gut: OrganSurface) -> None:
    world = world_in(gut, Contents(liquid=2))
    over = np.diag([1.0, -1.0, -1.0, 1.0])
    world.step(Control(T_world_patient=over), 0.01)
    lumen_contents = world.state.lumen_contents
    assert lumen_contents is not None and lumen_contents.pools is not None
    vertices = (gut.vertices @ over[:3, :3].T)[:, 2]
    wet = vertices < lumen_contents.pools.levels[np.maximum(lumen_contents.pools.of_vertex, 1) - 1]
    assert gut.vertices[wet, 2].min() > 0.0


def test_a_flush_washes_off_what_is_near_and_a_snapshot_knows_it() -> None:
    """Half of all within 5 cm, then the other half; liquid and what is farther stay."""
    contents = Contents(bubbles=Bubbles(per_area=2e4, burst_rate=0.0, on_dome=2), liquid=2, drift=0)
    gut = straight_gut({"jejunum": 0.3}, radius=0.012, edge=4e-3)
    model = Model(gut, read_device("mirocam"), contents=contents)
    world = World(model, substep=1e-3)
    before = world.state
    assert before.lumen_contents is not None
    center = before.T_world_capsule[:3, 3]

    def left(state: State) -> np.ndarray:
        assert state.lumen_contents is not None
        away = np.linalg.norm(state.lumen_contents.spheres.centers - center, axis=1)
        return np.array([(away < 0.04).sum(), ((away > 0.06) & (away < 1.0)).sum()])

    near, far = left(before)
    world.step(Control(flush=0.5), 0.01)
    half = world.snapshot()
    assert left(world.state)[0] == pytest.approx(0.5 * near, abs=0.15 * near)
    world.step(Control(flush=1.0), 0.01)
    assert left(world.state).tolist() == [0, far]
    world.step(Control(), 0.1)
    assert left(world.state)[0] == 0
    last = world.state.lumen_contents
    assert last is not None
    assert last.pools is not None
    assert last.pools.volume.sum() == pytest.approx(before.lumen_contents.pools.volume.sum())
    again = World(model, substep=1e-3)
    again.restore(half)
    again.step(Control(flush=1.0), 0.01)
    again.step(Control(), 0.1)
    assert again.state.lumen_contents is not None
    np.testing.assert_array_equal(again.state.lumen_contents.spheres.centers, last.spheres.centers)
    with pytest.raises(InputError, match=r"Control's flush is 1\.5\. Allowed: 0 to 1"):
        Control(flush=1.5)
