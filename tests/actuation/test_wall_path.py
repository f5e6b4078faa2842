"""Ways along a wall: on it, smooth, turned as they should be; and a target that waits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.actuation.capsule_target import CapsuleTarget, wall_target
from vrcaps.actuation.magnet_actuator import FreeActuator
from vrcaps.actuation.magnet_controller import MagnetController
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.actuation.wall_path import (
    PathFollower,
    PointToPointPlanner,
    WallPath,
    centerline_wall_path,
    free_distance,
    project_path_to_wall,
    straight_wall_path,
)
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import magnet_pose
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

RADIUS = 0.014
UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])

SIMULATED = 0.5
"""Timeout of a planner [s], in the time of the simulation."""


@pytest.fixture(scope="module")
def tube() -> Model:
    """Along x, from 0 to 0.2 m."""
    gut = straight_gut({"jejunum": 0.2}, radius=RADIUS)
    return Model(gut, read_device("magnetic"), np.eye(4))


def turn_between(path: WallPath) -> np.ndarray:
    return np.linalg.norm(np.diff(path.directions, axis=0), axis=1)


@pytest.mark.parametrize(("wall", "sign"), [("upper", 1.0), ("lower", -1.0)])
def test_along_a_tube_the_capsule_touches_the_wall(tube, wall, sign):
    """In a round tube of radius R a capsule of radius r that lies along is R − r off its axis."""
    path = centerline_wall_path(tube, 0.04, 0.12, wall=wall)
    off = RADIUS - tube.device.radius
    np.testing.assert_allclose(path.positions[:, 2], sign * off, atol=3e-4)
    np.testing.assert_allclose(
        path.wall_normals, np.tile(sign * UP, (len(path.positions), 1)), atol=0.02
    )
    np.testing.assert_allclose(path.directions @ AHEAD, 1.0, atol=1e-3)
    assert path.length == pytest.approx(0.08, rel=0.02)
    middle = path.target(0.5 * path.length)
    assert middle.on_planned_wall
    assert np.asarray(middle.position)[0] == pytest.approx(0.08, abs=1e-3)


def test_back_along_a_tube_it_looks_as_it_is_told(tube):
    for is_backward, look in ((False, 1.0), (True, -1.0)):
        path = centerline_wall_path(tube, 0.12, 0.04, is_backward=is_backward)
        assert path.positions[0, 0] > path.positions[-1, 0]
        np.testing.assert_allclose(path.directions @ AHEAD, look, atol=1e-3)


def test_free_way_is_the_gap_to_a_round_wall(tube):
    """Off the axis by d the wall above is √(R² − d²) high; the capsule's side touches at R − r."""
    rng = np.random.default_rng(0)
    across = rng.uniform(-0.005, 0.005, 20)
    points = np.stack([rng.uniform(0.05, 0.15, 20), across, np.zeros(20)], axis=1)
    way = free_distance(tube, points, np.tile(UP, (20, 1)), np.tile(AHEAD, (20, 1)))
    np.testing.assert_allclose(
        way, np.sqrt((RADIUS - tube.device.radius) ** 2 - across**2), atol=4e-4
    )
    nowhere = free_distance(tube, points[:1] + UP, UP[None], AHEAD[None])
    assert nowhere[0] == 0.0


def test_a_straight_way_turns_at_its_ends_only(tube):
    start = wall_target(tube, np.array([0.08, 0.0, 0.01]), np.array([1.0, 1.0, 0.0]))
    end = wall_target(tube, np.array([0.11, 0.0, 0.01]), np.array([0.0, 1.0, 0.0]))
    path = straight_wall_path(tube, start, end)
    moves = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) > 1e-6
    assert turn_between(path)[moves].max() < 1e-2
    assert turn_between(path).max() < 0.03
    np.testing.assert_allclose(path.directions[0], start.direction, atol=0.05)
    np.testing.assert_allclose(path.directions[-1], end.direction, atol=0.05)
    lying = path.directions[moves.argmax() + 1]
    assert lying @ AHEAD == pytest.approx(1.0, abs=1e-2)


def test_it_turns_the_other_way_round_where_it_must(tube):
    first, last = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (0.3, -0.3))
    place = np.array([0.1, 0.0, 0.01])
    start, end = wall_target(tube, place, first), wall_target(tube, place, last)
    short = straight_wall_path(tube, start, end)
    long = straight_wall_path(tube, start, end, avoid=AHEAD)
    assert turn_between(short).sum() == pytest.approx(0.6, abs=0.05)
    assert turn_between(long).sum() == pytest.approx(2.0 * np.pi - 0.6, abs=0.05)
    assert (long.directions @ AHEAD).max() < np.cos(0.25)


def test_ends_and_neighbors_of_a_laid_way_are_smooth(tube):
    rng = np.random.default_rng(1)
    x = np.linspace(0.05, 0.15, 101)
    points = np.stack([x, 1e-3 * rng.normal(size=101), np.zeros(101)], axis=1)
    path = project_path_to_wall(tube, points, np.tile(UP, (101, 1)), np.tile(AHEAD, (101, 1)))
    assert np.abs(np.diff(path.positions[:, 1], 2)).max() < 2e-4
    np.testing.assert_allclose(np.linalg.norm(path.wall_normals, axis=1), 1.0)
    assert np.abs((path.wall_normals * path.directions).sum(axis=1)).max() < 0.05


def test_the_goal_waits_for_the_capsule(tube):
    path = centerline_wall_path(tube, 0.04, 0.06)
    follower = PathFollower(path, speed=0.01, lookahead=5e-3)
    behind = magnet_pose(path.positions[0], AHEAD)
    for _ in range(1000):
        target = follower.target(behind, 0.01)
    assert np.asarray(target.position)[0] - behind[0, 3] == pytest.approx(5e-3, abs=3e-4)
    assert not follower.has_arrived
    for _ in range(200):
        pose = magnet_pose(np.asarray(follower.target(behind, 0.01).position), AHEAD)
        follower.target(pose, 0.01)
    assert follower.has_arrived


def test_what_cannot_be(tube):
    target = wall_target(tube, np.array([0.1, 0.0, 0.01]), AHEAD)
    with pytest.raises(InputError, match="The start has no direction"):
        straight_wall_path(tube, replace(target, direction=None), target)
    with pytest.raises(InputError, match="The end has no direction"):
        straight_wall_path(tube, target, CapsuleTarget((0, 0, 0)))
    with pytest.raises(InputError, match=r"end is 0\.1"):
        centerline_wall_path(tube, 0.1, 0.1)
    with pytest.raises(InputError, match=r"arc_length is 0\.2"):
        centerline_wall_path(tube, 0.1, 5.0)


DT = 0.01
AHEAD = np.array([1.0, 0.0, 0.0])


def on_wall(model: Model, x: float) -> CapsuleTarget:
    return wall_target(model, np.array([x, 0.0, 0.01]), AHEAD)


def begin(actuator: FreeActuator) -> tuple[MagnetController, World]:
    """A capsule under the upper wall of a tube along x, at 0.1 m."""
    gut = straight_gut({"jejunum": 0.2}, radius=0.014)
    model = Model(gut, read_device("magnetic"), np.eye(4))
    target = on_wall(model, 0.1)
    pose = magnet_pose(np.asarray(target.position) - [0, 0, 1e-3], AHEAD)
    controller = MagnetController(model, read_magnet("cylinder-101.6"), actuator, pose, target)
    return controller, World(
        model, Tissue(), State(0.0, pose), sources=controller.sources, substep=2e-4
    )


def run(planner: PointToPointPlanner, world: World, most: float) -> None:
    while not (planner.is_settled or planner.has_failed or world.time > most):
        world.step(planner.control(world, DT), DT)


@pytest.mark.slow
def test_leads_the_capsule_to_the_target():
    controller, world = begin(FreeActuator())
    target = on_wall(controller.model, 0.115)
    planner = PointToPointPlanner(controller, world.T_world_capsule, target)
    run(planner, world, 6.0)
    assert planner.is_settled
    assert not planner.has_failed
    assert controller.status.lost == ""
    off = world.T_world_capsule[:3, 3] - np.asarray(target.position)
    assert np.linalg.norm(off[:2]) < 1e-3  # the soft wall yields by 1 mm in z
    assert world.T_world_capsule[:3, 2] @ AHEAD > np.cos(np.radians(3.0))


@pytest.mark.slow
def test_tries_anew_and_says_that_it_failed():
    """A magnet that cannot leave its place leads the capsule nowhere."""
    free, _ = begin(FreeActuator())
    x, y, z = free.status.actuator.T_world_magnet[:3, 3].tolist()
    tied = FreeActuator(
        Workspace(low=(x - 1e-3, y - 1e-3, z - 1e-3), high=(x + 1e-3, y + 1e-3, z + 5e-2))
    )
    controller, world = begin(tied)
    planner = PointToPointPlanner(
        controller,
        world.T_world_capsule,
        on_wall(controller.model, 0.12),
        attempts=2,
        timeout=SIMULATED,
    )
    run(planner, world, 8.0)
    assert planner.has_failed
    assert planner.attempts == 0
    assert not planner.is_settled
    assert controller.status.lost


def test_needs_a_try():
    controller, world = begin(FreeActuator())
    target = on_wall(controller.model, 0.1)
    with pytest.raises(InputError, match="attempts is 0"):
        PointToPointPlanner(controller, world.T_world_capsule, target, attempts=0)
