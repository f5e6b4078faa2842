"""Training: resumed to the same bytes, run without PyTorch, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.small_envs import SHORT_GUT, small_settings

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from vrcaps.core.errors import InputError
from vrcaps.env.actuation import Wrench
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.mlp_policy import MlpPolicy, read_mlp_policy
from vrcaps.policy.policy import Policy
from vrcaps.policy.ppo import Ppo, PpoSettings
from vrcaps.policy.training import TrainingSettings, train
from vrcaps.training import Progress

LEARNER = PpoSettings(
    num_envs=2, num_actions=24, updates=2, hidden=(8, 8), batch=4, epochs=2, evaluate_every=2
)


def settings_of(learner: PpoSettings = LEARNER, **keywords: Any) -> TrainingSettings:
    """Three rounds of two episodes of four actions of 10 ms."""
    env = small_settings(
        organs=(SHORT_GUT,), control_period=0.01, episode_time=0.04, num_points=256, **keywords
    )
    return TrainingSettings(env, replace(learner, evaluation_episodes=2))


def killed_after(count: int) -> Callable[[Progress], None]:
    def report(progress: Progress) -> None:
        if progress.step == count:
            raise KeyboardInterrupt

    return report


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trained")
    assert train(settings_of(), out).step == 3
    return out


@pytest.mark.slow
def test_cut_off_and_resumed_it_ends_in_the_same_bytes(trained: Path, tmp_path: Path) -> None:
    for count in (0, 1, 2):
        with pytest.raises(KeyboardInterrupt):
            train(settings_of(), tmp_path, report=killed_after(count))
    assert train(settings_of(), tmp_path).step == 3
    for name in ("policy.npz", "best.npz"):
        assert (tmp_path / name).read_bytes() == (trained / name).read_bytes()
    lines = (tmp_path / "progress.csv").read_text().splitlines()
    assert len(lines) == 4
    assert "evaluation_coverage_visible" in lines[0]


@pytest.mark.slow
def test_another_seed_is_another_policy(trained: Path, tmp_path: Path) -> None:
    train(replace(settings_of(), seed=1), tmp_path)
    assert (tmp_path / "policy.npz").read_bytes() != (trained / "policy.npz").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["continuous", "discrete"])
def test_numpy_acts_as_torch_does(mode: Any) -> None:
    settings = settings_of(actuation=Wrench(mode))
    learner = Ppo(settings.env, settings.learner, 0)
    learner.run_round(0)
    policy = learner.policy()
    rows = np.random.default_rng(0).normal(size=(50, 19)).astype(np.float32)
    normal = learner.envs.normalize_obs(rows)
    expected, _ = learner.model.predict(normal, deterministic=True)
    envs = CapsuleVectorEnv(settings.env, 50)
    actions = policy.act({"state": rows}, envs)
    assert np.allclose(actions, expected, atol=1e-5)
    assert np.array_equal(policy.act({"state": rows[7:8]}, envs)[0], actions[7])
    assert all(envs.single_action_space.contains(a) for a in actions.astype(expected.dtype))


@pytest.mark.slow
def test_a_file_holds_the_policy_and_its_settings(trained: Path) -> None:
    policy = read_policy(trained / "policy.npz")
    assert isinstance(policy, MlpPolicy)
    assert isinstance(policy, Policy)
    assert policy.requires.settings["control_period"] == 0.01
    assert policy.requires.observations == ("state",)
    stated = json.loads((trained / "settings.json").read_text())
    assert stated["made_with"]["core"]
    assert stated["settings"]["learner"]["hidden"] == [8, 8]


@pytest.mark.slow
def test_a_policy_refuses_other_observations_and_actions(trained: Path) -> None:
    policy = read_mlp_policy(trained / "policy.npz")
    settings = settings_of().env
    rows = np.zeros((1, 25), np.float32)
    with pytest.raises(InputError, match="have 25 numbers; the policy was trained with 19"):
        policy.act({"state": rows}, CapsuleVectorEnv(settings))
    discrete = CapsuleVectorEnv(replace(settings, actuation=Wrench("discrete")))
    with pytest.raises(InputError, match=r"outputs 6 numbers per action.*Discrete\(7\)"):
        policy.act({"state": rows[:, :19]}, discrete)


@pytest.mark.slow
def test_a_folder_of_something_else_is_refused(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"other settings: learner\.epochs was 2, now 3"):
        train(settings_of(replace(LEARNER, epochs=3)), trained)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(InputError, match=r"contains no training\. Give a new or empty folder"):
        train(settings_of(), tmp_path)
    for name, text in (("settings.json", "{"), ("policy.npz", "nothing")):
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        (folder / name).write_text(text)
    with pytest.raises(InputError, match=r"settings\.json is damaged"):
        train(settings_of(), tmp_path / "settings_json")
    with pytest.raises(InputError, match=r"contains no policy\. Give a file"):
        read_mlp_policy(tmp_path / "policy_npz" / "policy.npz")


@pytest.mark.slow
def test_a_training_of_other_versions_goes_on_only_if_forced(trained: Path, tmp_path: Path) -> None:
    for name in ("settings.json", "checkpoint.npz"):
        (tmp_path / name).write_bytes((trained / name).read_bytes())
    stated = json.loads((tmp_path / "settings.json").read_text())
    stated["made_with"]["torch"] = "1.0"
    (tmp_path / "settings.json").write_text(json.dumps(stated))
    with pytest.raises(InputError, match=r"a training of other versions: torch was 1\.0, now"):
        train(settings_of(), tmp_path)
    assert train(settings_of(), tmp_path, is_forced=True).step == 3
    (tmp_path / "checkpoint.npz").write_bytes(b"cut off")
    with pytest.raises(InputError, match=r"checkpoint\.npz is damaged"):
        train(settings_of(), tmp_path, is_forced=True)


def test_bad_settings_are_one_line() -> None:
    with pytest.raises(InputError, match=r"hidden is \(\)"):
        PpoSettings(hidden=())
    with pytest.raises(InputError, match=r"gamma is 1\.5\. Allowed: 0 to 1"):
        PpoSettings(gamma=1.5)
