"""A learner imitates a teacher before its first round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from tests.support.small_envs import small_settings
from vrcaps.core.errors import InputError
from vrcaps.env.exploration import ExplorationObservation
from vrcaps.env.observations import StateObservation
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.mlp_policy import read_mlp_policy
from vrcaps.policy.ppo import Ppo, PpoSettings, imitate
from vrcaps.policy.training import BEST, TrainingSettings, train


def settings(**keywords: Any) -> TrainingSettings:
    own = (StateObservation(pose="located"), ExplorationObservation())
    given = {"actuation": "magnet", "control_period": 0.1, "episode_time": 1.0}
    env = small_settings(observations=own, dynamics="physics", **given | keywords)
    learner = PpoSettings(
        num_envs=2, num_actions=20, updates=1, hidden=(32,), evaluation_episodes=2,
        evaluate_every=1, teacher="explorer", teacher_rounds=2,
    )  # fmt: skip
    return TrainingSettings(env, learner)


@pytest.mark.slow
def test_the_error_is_a_small_part_of_the_actions() -> None:
    given = settings(episode_time=4.0)
    learner = Ppo(given.env, given.learner, 0)
    before = learner.policy().layers[0][0].copy()
    errors = imitate(learner, read_policy("explorer"))
    assert errors["imitation_error"] < 0.5 * errors["imitation_scale"]
    assert np.abs(learner.policy().layers[0][0] - before).max() > 0.0
    learner.close()


@pytest.mark.slow
def test_a_training_starts_from_its_teacher_and_gives_the_same_bytes(tmp_path: Path) -> None:
    folders = tmp_path / "one", tmp_path / "two"
    progress = train(settings(), folders[0])
    train(settings(), folders[1])
    assert "imitation_error" in progress.rows[0]
    assert (folders[0] / BEST).read_bytes() == (folders[1] / BEST).read_bytes()
    assert read_mlp_policy(folders[0] / BEST).requires.actuations == ("magnet",)


def test_a_teacher_must_fit() -> None:
    given = settings(actuation="wrench")
    learner = Ppo(given.env, given.learner, 0)
    with pytest.raises(InputError, match="explorer acts by magnet or arm"):
        imitate(learner, read_policy("explorer"))
    learner.close()


@pytest.mark.parametrize("name", ["centerline", "random", "next-best-view"])
def test_a_teacher_acts_by_observations(name: str, tmp_path: Path) -> None:
    """A network cannot infer the actions of one that reads the true state."""
    given = settings()
    given = replace(given, learner=replace(given.learner, teacher=name))
    with pytest.raises(InputError, match=rf"learner\.teacher is '{name}', .* Allowed: explorer"):
        train(given, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_teacher_of_another_actuation_leaves_no_folder(tmp_path: Path) -> None:
    given = settings()
    learner = replace(given.learner, teacher="coverage-ppo")
    with pytest.raises(InputError, match="coverage-ppo acts by wrench"):
        train(replace(given, learner=learner), tmp_path / "out")
    assert not (tmp_path / "out").exists()
