"""PettingZoo's parallel API: its own tests, organs of agents, rewards shared or not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, short_settings
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    pass

pytest.importorskip("pettingzoo")

from vrcaps.env.parallel_env import CapsuleParallelEnv

ORGANS = GUT, SHORT_GUT


def test_pettingzoo_accepts_it() -> None:
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    settings = short_settings(organs=ORGANS)
    parallel_api_test(CapsuleParallelEnv(settings), num_cycles=6)
    parallel_seed_test(lambda: CapsuleParallelEnv(settings), num_cycles=3)


def test_each_capsule_is_in_its_own_organ() -> None:
    env = CapsuleParallelEnv(short_settings(organs=ORGANS))
    env.reset(seed=0)
    found = [env.episode.simulation.worlds.patient(k).model.organ for k in range(2)]
    assert found == list(ORGANS)


def test_a_shared_reward_is_the_sum_of_all() -> None:
    settings = short_settings(organs=ORGANS)
    actions = {f"capsule_{k}": np.full(6, 0.5, np.float32) for k in range(2)}
    own, shared = (
        CapsuleParallelEnv(settings, is_reward_shared=is_shared) for is_shared in (False, True)
    )
    own.reset(seed=0)
    shared.reset(seed=0)
    earned, together = own.step(actions)[1], shared.step(actions)[1]
    assert list(together.values()) == pytest.approx([sum(earned.values())] * 2)


def test_who_is_done_leaves_the_others_behind() -> None:
    settings = short_settings(organs=ORGANS)
    env = CapsuleParallelEnv(replace(settings, episode_time=1.0))
    env.reset(seed=0)
    env.episode.simulation.worlds.time[1] = 1.0
    actions = {name: np.zeros(6, np.float32) for name in env.agents}
    *_, truncated, _ = env.step(actions)
    assert truncated == {"capsule_0": False, "capsule_1": True}
    assert env.agents == ["capsule_0"]
    assert set(env.step({"capsule_0": actions["capsule_0"]})[0]) == {"capsule_0"}
    env.close()


def test_a_missing_action_is_one_line() -> None:
    env = CapsuleParallelEnv(short_settings(organs=ORGANS))
    with pytest.raises(InputError, match="no agent is left; reset the environment"):
        env.step({})
    env.reset(seed=0)
    action = np.zeros(6, np.float32)
    with pytest.raises(InputError, match=r"given for: capsule_0\. Allowed: one for each of"):
        env.step({"capsule_0": action})
    with pytest.raises(InputError, match="The action is"):
        env.step(dict.fromkeys(env.agents, action + 2.0))
    with pytest.raises(InputError, match="render_mode is human"):
        CapsuleParallelEnv(render_mode="human")


def test_nothing_is_drawn_before_the_first_reset() -> None:
    env = CapsuleParallelEnv(short_settings(organs=ORGANS), render_mode="rgb_array")
    with pytest.raises(InputError, match=r"No episode has started.* Call reset first\."):
        env.render()
