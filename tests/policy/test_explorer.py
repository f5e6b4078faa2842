"""The explorer reads what a device has, sees more than a magnet at rest, and frees itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.coarse_organs import coarse_organ
from tests.support.small_envs import GUT, small_settings
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import ArmActuation
from vrcaps.env.settings import env_settings
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.explorer import Drive, Explorer, ExplorerPolicy, read_state

KNOWN = ("actuation", "control_period", "device", "memory")
"""Fields of a view that a device has: its parts, and the memory of these names."""
MEMORY = ("state/center", "magnet/box", "arm/base", "arm/joints")


def explored(**keywords: Any) -> CapsuleVectorEnv:
    """Environment of the explorer in a tube, after its reset."""
    given = {"dynamics": "physics", "control_period": 0.1} | keywords
    observations = ExplorerPolicy.requires.settings["observations"]
    settings = small_settings(observations=observations, **{"actuation": "magnet"} | given)
    return CapsuleVectorEnv(settings, 1, autoreset_mode="Disabled")


def hidden(envs: CapsuleVectorEnv) -> Any:
    """The environment with an error for every read of what a device does not have."""

    class Memory:
        def __getitem__(self, name: str) -> np.ndarray:
            assert name in MEMORY, name
            return envs.view.memory[name]

    class View:
        memory = Memory()

        def __getattr__(self, name: str) -> Any:
            assert name in KNOWN, name
            return getattr(envs.view, name)

    settings = SimpleNamespace(episode_time=envs.settings.episode_time)
    return SimpleNamespace(view=View(), num_envs=1, settings=settings)


@pytest.mark.parametrize("actuation", ["magnet", "arm"])
def test_it_reads_the_observations_alone(actuation: str) -> None:
    """Equal actions with and without the true state, and from two policies with one seed."""
    envs = explored(actuation=actuation)
    observations, _ = envs.reset(seed=0)
    policies = ExplorerPolicy(), ExplorerPolicy()
    for policy in policies:
        policy.reset(np.arange(1), [5])
    for _ in range(6):
        seen, blind = (
            policy.act(observations, given)
            for policy, given in zip(policies, (envs, hidden(envs)), strict=True)
        )
        np.testing.assert_array_equal(seen, blind)
        assert envs.single_action_space.contains(seen[0])
        observations, *_ = envs.step(seen)


@pytest.mark.slow
def test_it_sees_more_than_a_magnet_at_rest() -> None:
    seen = {}
    for name in ("explorer", "rest"):
        settings = env_settings(
            organs=(coarse_organ("stomach"),),
            dynamics="physics",
            substep=1e-3,
            num_points=1024,
            **ExplorerPolicy.requires.settings,
        )
        envs = CapsuleVectorEnv(settings, 1, autoreset_mode="Disabled")
        observations, infos = envs.reset(seed=1)
        policy = ExplorerPolicy()
        policy.reset(np.arange(1), [1])
        for _ in range(80):
            actions = np.zeros((1, 6), np.float32)
            if name == "explorer":
                actions = policy.act(observations, envs)
            observations, _, terminated, truncated, infos = envs.step(actions)
            if (terminated | truncated).any():
                break
        assert not infos["is_outside"].any()
        seen[name] = float(infos["coverage_visible"][0])
    assert seen["explorer"] > seen["rest"] + 0.2


def test_a_reading_has_the_state() -> None:
    envs = explored()
    row = envs.reset(seed=0)[0]["state"][0]
    reading, center = read_state(row, 60.0), envs.view.memory["state/center"][0]
    located = envs.view.memory["located/T"][0]
    np.testing.assert_allclose(reading.T_capsule[:3, 3] + center, located[:3, 3], atol=1e-6)
    np.testing.assert_allclose(reading.T_capsule[:3, :3], located[:3, :3], atol=1e-6)
    magnet = envs.view.memory["magnet/T"][0]
    np.testing.assert_allclose(reading.T_magnet[:3, 3] + center, magnet[:3, 3], atol=1e-6)
    np.testing.assert_allclose(reading.T_magnet[:3, 2], magnet[:3, 2], atol=1e-6)


@pytest.mark.parametrize("start", [0.0, 10.0])
def test_a_capsule_that_sees_the_wall_alone_is_pulled_away(start: float) -> None:
    """Also after ten episode times, where the observed time ends."""
    envs = explored()
    row = envs.reset(seed=0)[0]["state"][0].copy()
    reading = read_state(row, 60.0)
    explorer = Explorer(envs.view, Drive(envs.view, 0, reading.T_capsule[:3, :3]), 0)
    step = 0
    for step in range(40):
        row[18] = min(start + 0.1 * step / 60.0, 10.0)
        explorer.action(read_state(row, 60.0), np.full((40, 40), 5e-3))
        if explorer._plan is not None and explorer._plan.pull is not None:
            break
    assert explorer._plan is not None
    assert explorer._plan.pull is not None
    assert 2.0 <= 0.1 * step <= 3.0
    assert explorer._plan.pull @ reading.T_capsule[:3, 2] < 0.0


def test_it_needs_a_magnet_and_its_observations() -> None:
    explorer = read_policy("explorer")
    wrench = small_settings(
        actuation="wrench", **{"observations": ExplorerPolicy.requires.settings["observations"]}
    )
    with pytest.raises(InputError, match="explorer acts by magnet or arm; the environment's"):
        explorer.requires.check(wrench, "explorer")
    with pytest.raises(InputError, match="Add ray_distance"):
        explorer.requires.check(small_settings(actuation="magnet"), "explorer")
    memory = {"state/center": np.zeros((1, 3))}
    rope: Any = SimpleNamespace(actuation=SimpleNamespace(kind="rope"), memory=memory)
    rope.control_period = 0.1
    with pytest.raises(InputError, match="explorer does not support 'rope'"):
        Drive(rope, 0, np.eye(3))


def test_an_arm_brings_its_magnet_to_a_pose() -> None:
    """Position within 2 mm and moment within 1° after three seconds of limited joint speeds."""
    envs = CapsuleVectorEnv(small_settings(actuation="arm", organs=(GUT,)), 1)
    envs.reset(seed=0)
    actuation, memory = envs.settings.actuation, envs.view.memory
    assert isinstance(actuation, ArmActuation)
    goal = memory["magnet/T"][0].copy()
    goal[:3, 3] += [0.05, -0.04, 0.03]
    c, s = np.cos(0.5), np.sin(0.5)
    goal[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ goal[:3, :3]
    in_base = goal.copy()
    in_base[:3, 3] -= memory["arm/base"][0]
    for _ in range(30):
        action = actuation.towards(memory["arm/joints"][0], in_base, 0.1)
        assert np.abs(action).max() <= 1.0 + 1e-9
        memory["arm/joints"][0] += 0.1 * actuation._ranges[2] * action
    poses = actuation.controls(envs.view, np.zeros((1, 7)), np.array([0]))[0].Ts_world_magnet
    assert poses is not None
    pose = poses[0]
    assert np.linalg.norm(pose[:3, 3] - goal[:3, 3]) < 2e-3
    assert pose[:3, 2] @ goal[:3, 2] > np.cos(np.radians(1.0))
