"""The spring wall against a twin in NumPy and against the closed forms of its spring and damper."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.walls import RADIUS, floor, world_on
from vrcaps import _core
from vrcaps.core.units import MM
from vrcaps.tissue.tissue import Drag, SpringWall, WinklerFoundation

SPRING = SpringWall()
DOWN, FREE, STILL = (0.0, 0.0, -9.81), (0.0,) * 6, (0.0,) * 3
DT = 5e-5


def attenuated(places: np.ndarray, pushes: np.ndarray, spring_wall: SpringWall) -> np.ndarray:
    """F_v = Σ F / (1 + (d/d₀)²) over all pushes within reach."""
    distance = np.linalg.norm(places[:, None] - pushes[None, :, :3], axis=2)
    weight = np.where(
        distance < spring_wall.reach, 1.0 / (1.0 + (distance / spring_wall.length) ** 2), 0.0
    )
    return weight @ pushes[:, 3:]


def twin(before: np.ndarray, force: np.ndarray, spring_wall: SpringWall, dt: float) -> np.ndarray:
    """The paper's update: Δv = (F_v − k x) Δt / m, v ← v (1 − μ Δt), Δx = v Δt."""
    place, velocity = before[:, :3], before[:, 3:]
    velocity = velocity + (force - spring_wall.stiffness * place) * dt / spring_wall.mass
    velocity = velocity * (1.0 - spring_wall.damping * dt)
    return np.hstack([place + velocity * dt, velocity])


def pressed(size: float = 80.0 * MM, spring_wall: SpringWall = SPRING) -> _core.World:
    return world_on(
        floor(2.0 * MM, size),
        position=(1.0 * MM, 0.0, 0.95 * RADIUS),
        foundation=WinklerFoundation(),
        drag=Drag(),
        spring_wall=spring_wall,
    )


@pytest.mark.parametrize(
    "spring_wall", [SPRING, SpringWall(length=9 * MM, reach=30 * MM, stiffness=40.0, damping=0.0)]
)
def test_term_by_term(spring_wall: SpringWall) -> None:
    world = pressed(spring_wall=spring_wall)
    for _ in range(40):
        before = world.wall_displacement
        world.step(DT, 1, (0.3, 0.0, -1.0, 0.0, 1e-3, 0.0), DOWN)
        pushes = world.contact_forces()
        force = attenuated(world.active_wall + before[:, :3], pushes, spring_wall)
        np.testing.assert_allclose(
            world.wall_displacement, twin(before, force, spring_wall, DT), atol=1e-15
        )
        np.testing.assert_allclose(-pushes[:, 5].sum(), world.contact()[2], rtol=0.05)
    assert np.abs(world.wall_displacement[:, :3]).max() > 1e-6


def test_all_within_reach_give_way_along_a_long_way() -> None:
    """The capsule slides farther than vertices are searched around a push, and starts elsewhere."""
    world = pressed()
    rotation = world.pose[1]
    places = [(-10.0 * MM, 0.0, 0.95 * RADIUS), (5.0 * MM, 8.0 * MM, 0.95 * RADIUS)]
    for place in places:
        world.pose = (place, rotation, (0.6, 0.2, 0.0), (0.0, 0.0, 0.0))
        for _ in range(300):
            before = world.wall_displacement
            world.step(DT, 1, (0.3, 0.1, -1.0, 0.0, 0.0, 0.0), DOWN)
            force = attenuated(world.active_wall + before[:, :3], world.contact_forces(), SPRING)
            expected = twin(before, force, SPRING, DT)
            assert np.abs(world.wall_displacement - expected).max() < 1e-6
        went = np.subtract(world.pose[0], place)
        assert np.linalg.norm(went) > 6.0 * MM


@pytest.mark.slow
def test_static_depth() -> None:
    """At rest each vertex stands back by F_v / k."""
    world = pressed()
    world.step(1e-4, 12_000, FREE, DOWN)
    pushes, at_rest = world.contact_forces(), world.wall_displacement[:, :3]
    assert -pushes[:, 5].sum() == pytest.approx(3e-3 * 9.81, rel=5e-3)
    expected = attenuated(world.active_wall + at_rest, pushes, SPRING) / SPRING.stiffness
    deepest = np.abs(expected).max()
    np.testing.assert_allclose(at_rest, expected, atol=0.02 * deepest)


@pytest.mark.slow
def test_recovery() -> None:
    """Let go, x(t) = x₀ e^(−μt/2) (cos ωt + μ/(2ω) sin ωt), ω² = k/m − μ²/4."""
    world = pressed()
    world.step(1e-4, 12_000, FREE, DOWN)
    away = (0.0, 0.0, 60.0 * MM)
    world.pose = (away, (1.0, 0.0, 0.0, 0.0), STILL, STILL)
    start = world.wall_displacement
    start[:, 3:] = 0.0
    world.wall_displacement = start
    half = 0.5 * SPRING.damping
    omega = np.sqrt(SPRING.stiffness / SPRING.mass - half**2)
    for number in range(1, 9):
        world.step(DT, 200, FREE, STILL)
        t = number * 200 * DT
        share = np.exp(-half * t) * (np.cos(omega * t) + half / omega * np.sin(omega * t))
        error = world.wall_displacement[:, :3] - share * start[:, :3]
        assert np.abs(error).max() < 0.01 * np.abs(start[:, :3]).max()
    world.step(1e-4, 10_000, FREE, STILL)
    assert not world.wall_displacement.any()  # back at rest to the bit


def test_cost_is_local() -> None:
    """Sixteen times the wall, the same vertices move, none beyond the reach."""

    def moved(world: _core.World) -> np.ndarray:
        world.step(DT, 100, (0.0, 0.0, -1.0, 0.0, 0.0, 0.0), DOWN)
        return world.active_wall[np.any(world.wall_displacement != 0.0, axis=1)]

    small, large = moved(pressed(size=80.0 * MM)), moved(pressed(size=320.0 * MM))
    assert len(large) == pytest.approx(len(small), rel=0.1)
    # The capsule lies along y: its axis ends 7.5 mm from its middle.
    beyond = np.maximum(np.abs(large[:, 1]) - 7.5 * MM, 0.0)
    across = np.hypot(large[:, 0] - 1.0 * MM, beyond)
    assert across.max() < RADIUS + SPRING.reach + 2.0 * MM
