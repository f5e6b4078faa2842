"""Every task with every actuation and every observation keeps the promises of the API."""

import json
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.support.small_envs import LESION_GUT, small_settings
from tests.support.tubes import straight_gut, textured
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import MM
from vrcaps.env import ACTUATIONS, OBSERVATIONS, TASKS, CapsuleEnv, CapsuleVectorEnv
from vrcaps.env.randomization import Start
from vrcaps.env.settings import EnvSettings, env_settings
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.tissue import Tissue

ORGAN = textured(LESION_GUT)
EACH_TASK_AND_ACTUATION = [(task, actuation) for task in TASKS for actuation in ACTUATIONS]
"""Observations do not depend on each other: one environment has them all."""


def settings(task: str, actuation: str, **keywords: Any) -> EnvSettings:
    given = {"organs": (ORGAN,), "lesions": (), "control_period": 0.02, "num_points": 256}
    given |= {"task": task, "actuation": actuation, "observations": tuple(OBSERVATIONS)}
    given["start"] = Start(fraction=(0.5, 0.5), settle=0.1)
    return small_settings(**given | keywords)


def rollout(env: CapsuleEnv, seed: int, steps: int = 3) -> list[Any]:
    """All that an environment returns under random actions."""
    env.action_space.seed(seed)
    told = list(env.reset(seed=seed))
    for _ in range(steps):
        told += env.step(env.action_space.sample())
    return told


def assert_same(one: Any, other: Any) -> None:
    """The same bytes."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_same(one[name], other[name])
    else:
        assert np.array_equal(np.asarray(one), np.asarray(other)), (one, other)


def arrays(told: Any) -> list[np.ndarray]:
    """All arrays within what an environment returns."""
    if isinstance(told, dict):
        return [array for value in told.values() for array in arrays(value)]
    return [told] if isinstance(told, np.ndarray) and told.ndim else []


@pytest.mark.parametrize(("task", "actuation"), EACH_TASK_AND_ACTUATION)
def test_gymnasium_accepts_it(task: str, actuation: str) -> None:
    start = Start(fraction=(0.5, 0.5), settle=0.0)
    env = CapsuleEnv(settings(task, actuation, observations="state", start=start))
    check_env(env, skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_gymnasium_and_stable_baselines_accept_each_observation(observation: str) -> None:
    env = CapsuleEnv(settings("coverage", "magnet", observations=observation))
    check_env(env, skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(env, warn=False)


@pytest.mark.parametrize(("task", "actuation"), EACH_TASK_AND_ACTUATION)
def test_seed_and_actions_decide_all_bytes_alone_or_beside_others(
    task: str, actuation: str
) -> None:
    env, envs = (
        CapsuleEnv(settings(task, actuation)),
        CapsuleVectorEnv(settings(task, actuation), 2),
    )
    told = rollout(env, seed=3)
    for one, other in zip(told, rollout(env, seed=3), strict=True):
        assert_same(one, other)
    actions = []
    for seed in (2, 3):
        env.action_space.seed(seed)
        actions.append([env.action_space.sample() for _ in range(3)])
    beside = list(envs.reset(seed=2))
    for pair in zip(*actions, strict=True):
        beside += envs.step(np.stack(pair))
    for one, other in zip(told, beside, strict=True):
        is_named = isinstance(other, dict)
        row = {k: v[1] for k, v in other.items() if k[0] != "_"} if is_named else other[1]
        assert_same(one, row)


@pytest.mark.parametrize(("task", "actuation"), EACH_TASK_AND_ACTUATION)
def test_nothing_returned_shares_memory(task: str, actuation: str) -> None:
    envs = CapsuleVectorEnv(settings(task, actuation), 2)
    told, held = [*envs.reset(seed=0)], envs.episode.simulation
    told += envs.step(envs.action_space.sample())
    kept = [array for part in told for array in arrays(part)]
    before = [array.copy() for array in kept]
    inside = [*held.memory._arrays.values()]
    for array in kept:
        assert not any(np.shares_memory(array, other) for other in inside)
    envs.step(envs.action_space.sample())
    for array, same in zip(kept, before, strict=True):
        assert np.array_equal(array, same)


@pytest.mark.parametrize("actuation", ACTUATIONS)
def test_an_action_out_of_the_space_is_one_clear_line(actuation: str) -> None:
    env = CapsuleEnv(settings("coverage", actuation))
    with pytest.raises(InputError, match="a reset before the first step"):
        env.step(env.action_space.sample())
    env.reset(seed=0)
    action = env.action_space.sample()
    for wrong in (action * np.nan, action * 0 + 1.5, action[:-1]):
        with pytest.raises(InputError, match=r"The action is \[.*Allowed: 1 of Box") as told:
            env.step(wrong)
        assert "\n" not in str(told.value)


def test_a_gut_that_is_too_narrow_and_unknown_names_are_one_clear_line() -> None:
    narrow = straight_gut({"upper": 0.05}, radius=2.5 * MM, edge=1.0 * MM)
    with pytest.raises(InputError, match="the capsule fits nowhere"):
        CapsuleEnv(settings("coverage", "wrench", organs=(narrow,))).reset(seed=0)
    for name, noun in (("task", "task"), ("actuation", "actuation"), ("observations", "observ")):
        with pytest.raises(UnknownNameError, match=f"No {noun}.* named 'juggle'. Known: "):
            small_settings(**{name: "juggle"})
    with pytest.raises(UnknownNameError, match="No setting named 'organ'"):
        gymnasium.make("vrcaps.env:Navigate-v0", organ="colon")


def test_settings_are_the_same_after_a_file() -> None:
    """Through plain values, with parts of every kind."""
    elastic = Tissue(deformation=FemDeformation(edge=0.02))
    for settings in (
        env_settings(organs="colon", actuation="magnet", observations=("state", "map")),
        env_settings(organs="stomach", task="navigate", tissue=elastic),
        env_settings(organs="stomach", tissue=Tissue(deformation=None)),
    ):
        plain = json.loads(json.dumps(to_plain(settings, EnvSettings)))
        assert from_plain(EnvSettings, plain, at="env") == settings
