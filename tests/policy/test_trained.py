"""Policies that come with the package do what is said of them, in organs they never learned in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vrcaps.policy
from vrcaps.env.settings import env_settings
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.catalog import policy_names, read_policy
from vrcaps.scenario.scenario import OrganGenerated

FOLDER = Path(vrcaps.policy.__file__).parent / "trained"
FILES = sorted(FOLDER.glob("*.npz"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_each_is_small_and_listed(path: Path) -> None:
    assert path.stat().st_size < 500e3
    assert f"`{path.name}`" in (FOLDER / "README.md").read_text()
    (actuation,) = read_policy(path.stem).requires.actuations
    assert path.stem in policy_names(actuation)


@pytest.mark.slow
def test_coverage_ppo_sees_unseen_stomachs_sooner_than_the_centerline_leads() -> None:
    """Two stomachs in which it never learned, 10 s of each, the same starts."""
    policies = {name: read_policy(name) for name in ("coverage-ppo", "centerline")}
    organs = tuple(OrganGenerated("stomach", seed=seed) for seed in (100, 101))
    settings = env_settings(
        **{**policies["coverage-ppo"].requires.settings, "organs": organs, "episode_time": 10.0}
    )
    seen = {}
    for name, policy in policies.items():
        envs = CapsuleVectorEnv(settings, 4, autoreset_mode="Disabled")
        observations, infos = envs.reset(seed=7)
        policy.reset(np.arange(4), range(4))
        over = np.zeros(4, bool)
        while not over.any():
            actions = policy.act(observations, envs)
            observations, _, terminated, truncated, infos = envs.step(actions)
            over = terminated | truncated
        assert not infos["is_outside"].any()
        seen[name] = infos["coverage_visible"]
    assert seen["coverage-ppo"].mean() > 0.96
    assert seen["coverage-ppo"].mean() > seen["centerline"].mean() + 0.01
