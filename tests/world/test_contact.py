"""Contact with a soft wall against closed forms and conservation laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from tests.support.walls import HALF_AXIS, LINEAR, RADIUS, capsule, creased, floor, tube, world_on
from vrcaps.capsule.device import homogeneous_body
from vrcaps.capsule.device_file import read_device
from vrcaps.core.units import MM
from vrcaps.tissue.tissue import Drag, SpringWall, Tissue, WinklerFoundation

DOWN = (0.0, 0.0, -9.81)
FREE = (0.0,) * 6
R, K = RADIUS, LINEAR.stiffness


@pytest.mark.parametrize("edge", [4.0, 2.0, 1.0, 0.5])
@pytest.mark.parametrize("depth", [0.02, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("half_axis", [0.0, HALF_AXIS])
def test_force_and_patch_on_a_flat_wall(edge: float, depth: float, half_axis: float) -> None:
    """With u = R − s: F = π K (R − d) d² for a sphere, and for each length of a cylinder
    K (R − d) (2 R asinh(a/(R − d)) − 2 a), where a² = 2 R d − d² is the patch's radius."""
    d = depth * MM
    world = world_on(
        floor(edge * MM), position=(0.3 * MM, 0.1 * MM, R - d), body=capsule(half_axis)
    )
    world.step(1e-9, 1, FREE, (0.0,) * 3)
    a = np.sqrt(2.0 * R * d - d * d)
    force, area = np.pi * K * (R - d) * d * d, np.pi * a * a
    force += 2.0 * half_axis * K * (R - d) * (2.0 * R * np.arcsinh(a / (R - d)) - 2.0 * a)
    area += 2.0 * half_axis * 2.0 * a
    assert world.contact()[0][2] == pytest.approx(force, rel=0.03)
    assert np.sqrt(world.contact()[5]) == pytest.approx(np.sqrt(area), rel=0.03)
    assert world.contact()[6] == pytest.approx(d, abs=0.06 * MM)


def test_stiffening_wall() -> None:
    """A sphere on an exponential wall against the integral of its pressure."""
    foundation, d = WinklerFoundation(rate_gain=0.0), 2.0 * MM
    world = world_on(
        floor(1.0 * MM), position=(0.0, 0.0, R - d), body=capsule(0.0), foundation=foundation
    )
    world.step(1e-9, 1, FREE, (0.0,) * 3)
    stiffness, fold = foundation.stiffness, foundation.stiffening_depth

    def ring(s: float) -> float:
        pressure = stiffness * fold * np.expm1((R - s) / fold)
        return 2.0 * np.pi * pressure * (R - d)  # r dr = s ds; the normal's share is (R − d)/s

    assert world.contact()[0][2] == pytest.approx(quad(ring, R - d, R)[0], rel=0.03)


def test_a_narrow_lumen_grips_all_round() -> None:
    """Squeeze of the straight part: 2π r K u for each length."""
    lumen = 5.0 * MM
    wall = tube(lumen, 80.0 * MM, 0.8 * MM)
    short = world_on(wall, position=(0, 0, 40 * MM), wxyz=(1, 0, 0, 0), body=capsule(0.0))
    long = world_on(wall, position=(0, 0, 40 * MM), wxyz=(1, 0, 0, 0))
    for world in (short, long):
        world.step(1e-9, 1, FREE, (0.0,) * 3)
    grip = long.contact()[2] - short.contact()[2]
    assert grip == pytest.approx(2.0 * HALF_AXIS * 2.0 * np.pi * lumen * K * (R - lumen), rel=0.03)
    assert np.linalg.norm(long.contact()[0]) < 0.01 * grip


def test_free_flight_keeps_momentum_and_energy() -> None:
    world = world_on(
        floor(8.0 * MM), position=(0, 0, 30 * MM), velocity=(0.1, 0.0, 0.5), spin=(3.0, -8.0, 5.0)
    )
    energy = world.kinetic_energy() + 3e-3 * 9.81 * world.pose[0][2]
    world.step(5e-5, 1800, FREE, DOWN)
    position, _, velocity, _ = world.pose
    assert velocity == pytest.approx((0.1, 0.0, 0.5 - 9.81 * 0.09), abs=1e-12)
    assert position[2] == pytest.approx(30 * MM + 0.5 * 0.09 - 4.905 * 0.09**2, abs=1e-9)
    assert world.kinetic_energy() + 3e-3 * 9.81 * position[2] == pytest.approx(energy, rel=1e-6)


def test_sliding_loses_the_work_of_friction() -> None:
    """All that a sliding capsule loses is the work of friction; its deceleration is μ g."""
    friction, weight = 0.1, 3e-3 * 9.81
    world = world_on(
        floor(2.0 * MM),
        position=(-30 * MM, 0.0, R - 0.1 * MM),
        wxyz=(np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0),
        body=capsule(mass=3e-3),
        foundation=WinklerFoundation(youngs_modulus=3e5, stiffening_strain=np.inf),
        drag=Drag(friction=friction),
    )
    world.step(1e-4, 2_000, FREE, DOWN)  # settles
    place, wxyz, _, _ = world.pose
    world.pose = (place, wxyz, (0.2, 0.0, 0.0), (0.0, 0.0, 0.0))

    def energy() -> float:
        return world.kinetic_energy() + weight * world.pose[0][2] + world.contact()[4]

    world.step(5e-5, 1, FREE, DOWN)
    start, lost, way = energy(), 0.0, world.pose[0][0]
    world.step(5e-5, 2000, FREE, DOWN)
    lost = world.contact()[3]
    assert lost == pytest.approx(friction * weight * (world.pose[0][0] - way), rel=0.02)
    assert start - energy() == pytest.approx(lost, rel=0.02)


def test_friction_holds_on_a_slope() -> None:
    """Below the angle of friction a capsule that points downhill does not slide."""
    slope = np.radians(5.0)
    gravity = (9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope))
    wxyz = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # its axis points downhill
    world = world_on(
        floor(2.0 * MM),
        position=(0, 0, R),
        wxyz=wxyz,
        drag=Drag(friction=0.15),
        foundation=WinklerFoundation(),
    )
    world.step(1e-4, 3_000, FREE, gravity)
    before = np.array(world.pose[0])
    world.step(1e-4, 3_000, FREE, gravity)
    assert np.linalg.norm(np.array(world.pose[0]) - before) < 0.05 * MM


@pytest.mark.parametrize("force", [0.5, 5.0])
def test_does_not_tunnel(force: float) -> None:
    world = world_on(
        floor(2.0 * MM), position=(0, 0, 12 * MM), foundation=WinklerFoundation(), drag=Drag()
    )
    for _ in range(20):
        world.step(5e-5, 200, (0.0, 0.0, -force, 0.0, 0.0, 0.0), DOWN)
        assert world.pose[0][2] > 0.0
    assert world.contact()[0][2] == pytest.approx(force + 3e-3 * 9.81, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("spring_wall", [None, SpringWall()])
def test_no_fold_cuts_through_the_axis(spring_wall: SpringWall | None) -> None:
    """Thrown about at up to 20 m/s among folds with crests sharper than any pressed area."""
    rng = np.random.default_rng(3)
    wall = creased(40.0 * MM, 15.0 * MM)
    world = world_on(
        wall,
        position=(0, 0, 0),
        foundation=WinklerFoundation(),
        drag=Drag(),
        spring_wall=spring_wall,
    )
    assert world.inside()
    for _ in range(25):
        push = rng.normal(size=3)
        force = push * (5.0 / np.linalg.norm(push))
        for _ in range(10):
            world.step(5e-5, 40, (*force, 0.0, 0.0, 0.0), DOWN)
            world.settle()
            assert world.inside()


@pytest.mark.slow
@pytest.mark.parametrize("foundation", [LINEAR, WinklerFoundation()])
@pytest.mark.parametrize("speed", [3.0, 20.0])
def test_blows_make_no_energy(foundation: WinklerFoundation, speed: float) -> None:
    """Kinetic and stored energy never exceed what was thrown in."""
    rng = np.random.default_rng(0)
    wall = creased(40.0 * MM, 15.0 * MM)
    for _ in range(3):
        way = rng.normal(size=3)
        way *= speed / np.linalg.norm(way)
        world = world_on(wall, position=(0, 0, 0), velocity=tuple(way), foundation=foundation)
        thrown = world.kinetic_energy()
        for _ in range(60):
            world.step(5e-5, 20, FREE, (0.0,) * 3)
            assert world.kinetic_energy() + world.contact()[4] < 1.001 * thrown


def test_resistance_follows_the_measurements() -> None:
    """The physical law in a straight tube against 55.04 ln(0.23 v + 1.04) + 100 mN, 1 to 60 mm/s,
    with the squeeze measured on a live pig, 1.9 ± 1.0 N per cm."""
    wall, law = tube(4.2 * MM, 120.0 * MM, 1.0 * MM), Drag(law="continuous")
    heavy = capsule(mass=1e6)
    for speed in (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0):
        world = world_on(
            wall,
            position=(0, 0, 50 * MM),
            wxyz=(1, 0, 0, 0),
            velocity=(0, 0, speed * MM),
            body=heavy,
            foundation=WinklerFoundation(),
            drag=Drag(),
        )
        world.step(1e-5, 100, FREE, (0.0,) * 3)
        drag = -world.contact()[0][2]
        assert drag == pytest.approx(law.resistance(np.array(speed * MM)), rel=0.1)
        assert 0.9 < world.contact()[2] / 2.6 < 2.9


@pytest.mark.slow
@pytest.mark.parametrize("speed", [20.0 * MM, 60.0 * MM])
def test_the_default_tissue_presses_and_drags_as_measured(speed: float) -> None:
    """A tube 8.4 mm wide that gives way squeezes with 1.9 ± 1.0 N per cm and drags by the curve."""
    tissue, law, substep = Tissue(), Drag(law="continuous"), 2e-4
    assert isinstance(tissue.deformation, SpringWall)
    world = world_on(
        tube(4.2 * MM, 70.0 * MM, 1.2 * MM),
        position=(0, 0, 25 * MM),
        wxyz=(1, 0, 0, 0),
        body=capsule(mass=1e6),
        foundation=tissue.foundation_in_series,
        drag=tissue.drag,
        spring_wall=tissue.deformation,
    )
    world.step(substep, 500, FREE, (0.0,) * 3)
    place, wxyz, _, still = world.pose
    world.pose = (place, wxyz, (0.0, 0.0, speed), still)
    world.step(substep, round(4.0 * MM / speed / substep), FREE, (0.0,) * 3)
    world.step(substep, round(1.2 * MM / speed / substep), FREE, (0.0,) * 3)
    assert -world.contact()[0][2] == pytest.approx(law.resistance(np.array(speed)), rel=0.1)
    assert 0.9 < world.contact()[2] / 2.6 < 2.9
    assert np.abs(world.wall_displacement[:, :3]).max() > 0.4 * MM


@pytest.mark.parametrize("law", ["incetan2021", "continuous"])
def test_logarithmic_laws(law: str) -> None:
    """A capsule lying on the floor is slowed by the law's force."""
    drag = Drag(law=law)
    speed = np.array([0.0, 0.5, 1.0, 1.0 + 1e-9, 2.0, 50.0]) * MM
    world = world_on(floor(4 * MM), position=(0, 0, 0.9 * R), drag=drag)
    core = [world.resistance(v) for v in speed]
    np.testing.assert_allclose(core, drag.resistance(speed), rtol=1e-12)
    plain = 100.0 + 55.04 * np.log(0.23 * speed / MM + 1.04)
    expected = np.where((speed <= 1 * MM) & (law == "incetan2021"), 100.0, plain)
    np.testing.assert_allclose(drag.resistance(speed), expected * 1e-3, rtol=1e-9)


def test_inertia_of_a_homogeneous_capsule() -> None:
    """Against the moments of points spread evenly through the shape."""
    body = homogeneous_body(read_device("mirocam"))
    rng = np.random.default_rng(0)
    half, r = body.half_axis, body.radius
    p = rng.uniform(-1.0, 1.0, (400_000, 3)) * [r, r, half + r]
    off = p - np.clip(p, [0, 0, -half], [0, 0, half])
    p = p[(off**2).sum(axis=1) < r * r]
    moments = body.mass * ((p**2).sum(axis=1).mean() - (p**2).mean(axis=0))
    np.testing.assert_allclose(np.diag(body.inertia), moments, rtol=0.01)
