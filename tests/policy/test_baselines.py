"""Baselines in a straight tube: each acts within the space and does what it is named for."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.small_envs import small_settings
from vrcaps.env.actuation import Wrench
from vrcaps.env.randomization import Start
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.baselines import Walk, make_route
from vrcaps.policy.catalog import BASELINES, read_policy


def tube_env(num_worlds: int = 2) -> CapsuleVectorEnv:
    settings = small_settings(actuation=Wrench(is_weightless=True), dynamics="physics")
    env = CapsuleVectorEnv(settings, num_worlds, autoreset_mode="Disabled")
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("name", sorted(set(BASELINES) - {"explorer", "navigator"}))  # magnets
def test_a_baseline_sees_more_of_a_tube_as_it_goes(name: str) -> None:
    env, policy = tube_env(), read_policy(name)
    policy.reset(np.arange(2), [0, 1])
    before = env.view.coverage.seen("visible").copy()
    for _ in range(6):
        actions = policy.act({}, env)
        assert env.action_space.contains(actions)
        env.step(actions)
    simulation = env.episode.simulation
    assert (simulation.coverage.seen("visible") > before).all()
    assert not simulation.worlds.is_outside.any()


@pytest.mark.slow
def test_a_magnet_leads_the_capsule_along_the_centerline() -> None:
    """It goes to the nearer end on the wall below, pressed by a small part of its weight."""
    settings = small_settings(
        actuation="magnet", dynamics="physics", start=Start(fraction=(0.6, 0.6), settle=0.0)
    )
    env, policy = (
        CapsuleVectorEnv(settings, 1, autoreset_mode="Disabled"),
        read_policy("centerline"),
    )
    env.reset(seed=0)
    policy.reset(np.arange(1), [0])
    start = env.view.arc_length[0]
    for _ in range(15):
        actions = policy.act({}, env)
        assert env.action_space.contains(actions)
        env.step(actions)
    simulation = env.episode.simulation
    assert simulation.worlds.arc_length[0] > start + 0.02
    assert 0.0 < simulation.worlds.normal_force_total[0] < 0.2
    assert not simulation.worlds.is_outside.any()


def test_next_best_view_looks_both_ways_at_once() -> None:
    """A tube without folds is seen whole from its middle: only turning takes time."""
    env, policy = tube_env(1), read_policy("next-best-view")
    policy.reset(np.arange(1), [0])
    for _ in range(18):
        step = env.step(policy.act({}, env))
        if step[2].any():
            break
    assert env.view.coverage.seen("visible")[0] > 0.95


def test_a_walk_turns_at_the_ends_and_where_it_is_held_up() -> None:
    route = make_route(tube_env(1).view.patient(0).model)
    low, high = route.ends
    assert 0.0 < low < 0.03
    assert 0.15 < high < 0.18
    walk = Walk()
    walk.follow(route, 0.12, 0.0)
    assert walk.sign == 1  # the nearer end first
    walk.follow(route, high - 1e-3, 1.0)
    assert walk.sign == -1
    walk.follow(route, 0.1, 2.0)
    walk.follow(route, 0.1, 5.0)
    assert walk.sign == -1
    walk.follow(route, 0.1, 6.5)
    assert walk.sign == 1


def test_a_route_knows_where_the_capsule_fits() -> None:
    """The tube is 4 cm wide, the capsule 29 mm long and 12 mm thick."""
    route = make_route(tube_env(1).view.patient(0).model)
    middle = route.poses(np.array([0.09]))[0]
    across, along = middle[:3, 0], middle[:3, 2]
    point = middle[:3, 3] + 0.008 * across
    assert route.fits(np.stack([point, point + 0.008 * across])).tolist() == [True, False]
    assert route.is_free(np.stack([point] * 2), np.stack([along, across])).tolist() == [
        True,
        False,
    ]
    ends = np.stack([point + 0.03 * along, point + 0.03 * across])
    assert route.is_clear(point, ends).tolist() == [True, False]
