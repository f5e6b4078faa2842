"""Ways along a wall: on it, smooth, turned as they should be; and a goal that waits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tubes import straight_gut
from vrcaps.actuation.capsule_target import Goal, wall_goal
from vrcaps.actuation.wall_path import (
    Follower,
    WallPath,
    free_way,
    gut_wall_path,
    lay,
    straight_wall_path,
)
from vrcaps.capsule.catalog import read_device
from vrcaps.errors import InputError
from vrcaps.magnet.sources import magnet_pose
from vrcaps.world.model import Model

RADIUS = 0.014
UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def tube() -> Model:
    """Along x, from 0 to 0.2 m."""
    gut = straight_gut({"jejunum": 0.2}, radius=RADIUS)
    return Model(gut, read_device("magnetic"), np.eye(4))


def turn_between(path: WallPath) -> np.ndarray:
    return np.linalg.norm(np.diff(path.directions, axis=0), axis=1)


@pytest.mark.parametrize(("side", "sense"), [("up", 1.0), ("down", -1.0)])
def test_along_a_tube_the_capsule_touches_the_wall(tube, side, sense):
    """In a round tube of radius R a capsule of radius r that lies along is R − r off its axis."""
    path = gut_wall_path(tube, 0.04, 0.12, side=side)
    off = RADIUS - tube.device.radius
    np.testing.assert_allclose(path.places[:, 2], sense * off, atol=3e-4)
    np.testing.assert_allclose(path.presses, np.tile(sense * UP, (len(path.places), 1)), atol=0.02)
    np.testing.assert_allclose(path.directions @ AHEAD, 1.0, atol=1e-3)
    assert path.length == pytest.approx(0.08, rel=0.02)
    middle = path.goal(0.5 * path.length)
    assert middle.mapped
    assert np.asarray(middle.position)[0] == pytest.approx(0.08, abs=1e-3)


def test_back_along_a_tube_it_looks_as_it_is_told(tube):
    for backwards, look in ((False, 1.0), (True, -1.0)):
        path = gut_wall_path(tube, 0.12, 0.04, backwards=backwards)
        assert path.places[0, 0] > path.places[-1, 0]
        np.testing.assert_allclose(path.directions @ AHEAD, look, atol=1e-3)


def test_free_way_is_the_gap_to_a_round_wall(tube):
    """Off the axis by d the wall above is √(R² − d²) high; the capsule's side touches at R − r."""
    rng = np.random.default_rng(0)
    across = rng.uniform(-0.005, 0.005, 20)
    points = np.stack([rng.uniform(0.05, 0.15, 20), across, np.zeros(20)], axis=1)
    way = free_way(tube, points, np.tile(UP, (20, 1)), np.tile(AHEAD, (20, 1)))
    np.testing.assert_allclose(
        way, np.sqrt((RADIUS - tube.device.radius) ** 2 - across**2), atol=4e-4
    )
    nowhere = free_way(tube, points[:1] + UP, UP[None], AHEAD[None])
    assert nowhere[0] == 0.0


def test_a_straight_way_turns_at_its_ends_only(tube):
    start = wall_goal(tube, np.array([0.08, 0.0, 0.01]), np.array([1.0, 1.0, 0.0]))
    end = wall_goal(tube, np.array([0.11, 0.0, 0.01]), np.array([0.0, 1.0, 0.0]))
    path = straight_wall_path(tube, start, end)
    moves = np.linalg.norm(np.diff(path.places, axis=0), axis=1) > 1e-6
    assert turn_between(path)[moves].max() < 1e-2
    assert turn_between(path).max() < 0.03
    np.testing.assert_allclose(path.directions[0], start.direction, atol=0.05)
    np.testing.assert_allclose(path.directions[-1], end.direction, atol=0.05)
    lying = path.directions[moves.argmax() + 1]
    assert lying @ AHEAD == pytest.approx(1.0, abs=1e-2)


def test_it_turns_the_other_way_round_where_it_must(tube):
    first, last = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (0.3, -0.3))
    place = np.array([0.1, 0.0, 0.01])
    start, end = wall_goal(tube, place, first), wall_goal(tube, place, last)
    short = straight_wall_path(tube, start, end)
    long = straight_wall_path(tube, start, end, avoid=AHEAD)
    assert turn_between(short).sum() == pytest.approx(0.6, abs=0.05)
    assert turn_between(long).sum() == pytest.approx(2.0 * np.pi - 0.6, abs=0.05)
    assert (long.directions @ AHEAD).max() < np.cos(0.25)


def test_ends_and_neighbours_of_a_laid_way_are_smooth(tube):
    rng = np.random.default_rng(1)
    x = np.linspace(0.05, 0.15, 101)
    points = np.stack([x, 1e-3 * rng.normal(size=101), np.zeros(101)], axis=1)
    path = lay(tube, points, np.tile(UP, (101, 1)), np.tile(AHEAD, (101, 1)))
    assert np.abs(np.diff(path.places[:, 1], 2)).max() < 2e-4
    np.testing.assert_allclose(np.linalg.norm(path.presses, axis=1), 1.0)
    assert np.abs((path.presses * path.directions).sum(axis=1)).max() < 0.05


def test_the_goal_waits_for_the_capsule(tube):
    path = gut_wall_path(tube, 0.04, 0.06)
    follower = Follower(path, speed=0.01, lead=5e-3)
    behind = magnet_pose(path.places[0], AHEAD)
    for _ in range(1000):
        goal = follower.goal(behind, 0.01)
    assert np.asarray(goal.position)[0] - behind[0, 3] == pytest.approx(5e-3, abs=3e-4)
    assert not follower.arrived
    for _ in range(200):
        pose = magnet_pose(np.asarray(follower.goal(behind, 0.01).position), AHEAD)
        follower.goal(pose, 0.01)
    assert follower.arrived


def test_what_cannot_be(tube):
    goal = wall_goal(tube, np.array([0.1, 0.0, 0.01]), AHEAD)
    with pytest.raises(InputError, match="The start has no direction"):
        straight_wall_path(tube, replace(goal, direction=None), goal)
    with pytest.raises(InputError, match="The end has no direction"):
        straight_wall_path(tube, goal, Goal((0, 0, 0)))
    with pytest.raises(InputError, match=r"end is 0\.1"):
        gut_wall_path(tube, 0.1, 0.1)
    with pytest.raises(InputError, match=r"arc_length is 0\.2"):
        gut_wall_path(tube, 0.1, 5.0)
