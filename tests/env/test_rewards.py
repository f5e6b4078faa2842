"""Rewards in closed form."""

import numpy as np
import pytest

from tests.support.small_envs import simulation_of, small_env
from vrcaps.core.errors import InputError
from vrcaps.env.rewards import AreaGain, LogGain, TotalVariation, frontier_length, total_reward

_GRID = (10, 8)


def _length(seen):
    flat = np.asarray(seen, float).reshape(1, -1)
    return frontier_length(flat, np.ones_like(flat, bool), _GRID)[0]


def test_frontier_of_a_straight_front_is_one_circumference():
    seen = np.zeros(_GRID)
    assert _length(seen) == 0.0
    seen[:4] = 1.0
    assert _length(seen) == pytest.approx(1.0)
    assert _length(1.0 - seen) == pytest.approx(1.0)


def test_hole_lengthens_the_frontier_until_it_is_closed():
    seen = np.zeros(_GRID)
    seen[:6] = 1.0
    whole = _length(seen)
    seen[3, 7] = 0.0  # beside the seam of the map
    holed = _length(seen)
    # Four sides, of which two meet in one cell: sqrt(2) + 2.
    assert (holed - whole) * _GRID[1] == pytest.approx(np.sqrt(2.0) + 2.0)
    seen[3, 7] = 1.0
    assert _length(seen) == whole


def test_cells_without_wall_are_no_frontier():
    seen, wall = np.ones((1, 80)), np.ones((1, 80), bool)
    seen[0, 33], wall[0, 33] = 0.0, False
    assert frontier_length(seen, wall, _GRID)[0] == 0.0


def test_total_variation_pays_minus_the_frontiers_growth():
    env = small_env(rewards=(TotalVariation(2.0),))
    s = env.episode.simulation

    def length():
        coverage = s.coverage
        return frontier_length(coverage.cell_fraction, coverage.cell_area > 0.0, s.settings.grid)[0]

    s.coverage.cells[0, 30] = 0.0  # what the next look sees makes no hole smaller than this
    before = env.episode.simulation.memory["frontier/length"][0]
    *_, info = env.step(np.zeros(6))
    assert info["reward_total-variation"] == pytest.approx(2.0 * (before - length()))
    *_, info = env.step(np.zeros(6))
    assert info["reward_total-variation"] == pytest.approx(0.0, abs=1e-9)


def test_total_variation_is_of_the_map():
    with pytest.raises(InputError, match=r"has the level 'resolved'\. Allowed: 'visible'"):
        TotalVariation(level="resolved")


def test_rewards_of_one_term_at_two_levels_both_count() -> None:
    simulation = simulation_of()
    both = (AreaGain(2.0, "visible"), AreaGain(3.0, "resolved"))
    total, terms = total_reward(both, simulation.view)
    assert total > 0.0  # what the start shows
    assert total == pytest.approx(sum(reward.value(simulation.view) for reward in both))
    assert terms["area-gain"] == pytest.approx(total)


def test_log_gain_of_an_episode_is_the_log_of_what_is_left():
    env = small_env(rewards=(LogGain(level="resolved"),))
    simulation = env.episode.simulation
    began = 1.0 - simulation.coverage.seen("resolved")[0]
    earned = sum(env.step(np.full(6, 0.5))[1] for _ in range(5))
    ended = 1.0 - simulation.coverage.seen("resolved")[0]
    assert ended < began
    assert earned == pytest.approx(np.log((began + 0.005) / (ended + 0.005)))
