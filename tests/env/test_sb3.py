"""Adapter to Stable-Baselines3: its interface, ends of episodes, arrays of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.small_envs import short_settings
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import Wrench
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.vector_env import CapsuleVectorEnv

pytest.importorskip("stable_baselines3")

from vrcaps.env.sb3 import Sb3VecEnv


def test_steps_as_the_vector_environment_does_and_begins_anew_at_once() -> None:
    settings = short_settings()
    envs, native = Sb3VecEnv(settings, 2), CapsuleVectorEnv(settings, 2, autoreset_mode="SameStep")
    envs.seed(3)
    assert np.array_equal(envs.reset()["state"], native.reset(seed=3)[0]["state"])
    assert set(envs.reset_infos[0]) >= {"coverage_visible", "time"}
    actions = np.full((2, 6), 0.5, np.float32)
    kept = []
    for number in range(4):
        observations, rewards, over, infos = envs.step(actions)
        other, paid, *_, native_infos = native.step(actions)
        kept.append((observations["state"], observations["state"].copy()))
        assert np.array_equal(observations["state"], other["state"])
        assert np.array_equal(rewards, paid.astype(np.float32))
        assert over.tolist() == [number == 3] * 2
    assert all(np.array_equal(given, copy) for given, copy in kept)
    last = native_infos["final_obs"][1]["state"]
    assert np.array_equal(infos[1]["terminal_observation"]["state"], last)
    assert infos[1]["TimeLimit.truncated"] is True
    assert infos[1]["time"] == pytest.approx(0.04)
    assert not np.array_equal(observations["state"][1], last)


def test_a_task_that_is_done_is_no_time_limit() -> None:
    settings = short_settings()
    done = Sb3VecEnv(replace(settings, task=replace(settings.task, target=1e-6)))
    done.reset()
    *_, over, infos = done.step(np.zeros((1, 6), np.float32))
    assert over[0]
    assert infos[0]["TimeLimit.truncated"] is False


def test_a_flat_observation_has_the_keys_one_after_the_other() -> None:
    settings = short_settings()
    flat, keyed = Sb3VecEnv(settings, 2, is_flat=True), Sb3VecEnv(settings, 2)
    for envs in (flat, keyed):
        envs.seed(1)
    assert np.array_equal(flat.reset(), keyed.reset()["state"])
    assert flat.observation_space.shape == (19,)


def test_attributes_and_methods_are_those_of_the_vector_environment() -> None:
    envs = Sb3VecEnv(short_settings(), 3)
    assert envs.get_attr("render_mode") == [None] * 3
    assert len(envs.get_attr("settings", [0, 2])) == 2
    assert envs.env_method("render", indices=0) == [None]
    assert envs.env_is_wrapped(object) == [False] * 3  # type: ignore[arg-type]
    assert envs.seed(5) == [5, 6, 7]
    with pytest.raises(InputError, match="indices is 1"):
        envs.set_attr("render_mode", "rgb_array", 1)
    envs.set_attr("render_mode", None)
    envs.close()


@pytest.mark.slow
def test_ppo_takes_it() -> None:
    from stable_baselines3 import PPO

    model = PPO("MultiInputPolicy", Sb3VecEnv(short_settings(), 2), n_steps=4, batch_size=8)
    model.learn(16)
    assert model.num_timesteps == 16


@pytest.mark.parametrize("mode", ["continuous", "discrete"])
def test_stable_baselines_accepts_the_single_environment(mode: Any) -> None:
    from stable_baselines3.common.env_checker import check_env

    check_env(CapsuleEnv(short_settings(actuation=Wrench(mode))))
