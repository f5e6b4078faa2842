"""Longer trainings, and trainings that begin with what another has learned."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from tests.support.small_envs import SHORT_GUT, small_settings
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.policy.mlp_policy import read_mlp_policy
from vrcaps.policy.ppo import Ppo
from vrcaps.policy.training import TrainingSettings, ci, start_file, train, warm_start
from vrcaps.training import _with_grown


def settings(actions: int = 8, **learner) -> TrainingSettings:
    """A round of eight actions in a short tube."""
    env = small_settings(
        organs=(SHORT_GUT,), control_period=0.01, episode_time=0.04, num_points=256
    )
    ours = replace(ci().learner, num_actions=actions, evaluate_every=1, **learner)
    return TrainingSettings(env, ours)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("trained") / "run"
    train(settings(), out)
    return out


@pytest.mark.slow
def test_a_training_goes_on_with_more_actions_and_not_with_fewer(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert train(settings(), out).step == 1
    assert train(settings(24), out).step == 3
    stated = json.loads((out / "settings.json").read_text())["settings"]
    assert stated["learner"]["num_actions"] == 24
    with pytest.raises(InputError, match=r"learner\.num_actions was 24, now 8"):
        train(settings(8), out)
    with pytest.raises(InputError, match=r"learner\.gamma was"):
        train(settings(32, gamma=0.5), out)


@pytest.mark.slow
def test_a_start_gives_the_policy_and_its_normalizer(run: Path) -> None:
    """From a folder and from a file, before the first round."""
    trained = read_mlp_policy(run / "policy.npz")
    for start in (run, run / "policy.npz"):
        learner = Ppo(settings().env, settings().learner, 5)
        warm_start(learner, start_file(start))
        begun = learner.policy()
        learner.close()
        for (weight, bias), (own_weight, own_bias) in zip(
            trained.layers, begun.layers, strict=True
        ):
            np.testing.assert_array_equal(weight, own_weight)
            np.testing.assert_array_equal(bias, own_bias)
        np.testing.assert_allclose(begun.normalizer.mean, trained.normalizer.mean)


@pytest.mark.slow
def test_a_start_that_does_not_fit_is_one_line(run: Path, tmp_path: Path) -> None:
    other = settings(hidden=(8,))
    for start, message in (
        (run, "Cannot start from .*checkpoint.npz: .* Allowed: a training of the same"),
        (run / "policy.npz", r"has layers of .* Allowed: .* as the settings have"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            train(other, tmp_path / "other", start=start)
        assert "\n" not in str(caught.value)
        assert not (tmp_path / "other").exists()
    with pytest.raises(InputError, match=r"contains no checkpoint\.npz\. Give the folder"):
        start_file(tmp_path)
    started = train(settings(), tmp_path / "started", start=run)
    assert started.step == 1
    with pytest.raises(InputError, match=r"other settings: start was"):
        train(settings(), tmp_path / "started")


@pytest.mark.slow
def test_a_wrong_name_leaves_no_folder(tmp_path: Path) -> None:
    wrong = settings()
    wrong = replace(wrong, env=replace(wrong.env, organs=("stomac",)))
    with pytest.raises(UnknownNameError, match="No organ named 'stomac'"):
        train(wrong, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_only_named_settings_may_grow() -> None:
    before, now = {"a": {"n": 1, "m": 1}, "b": 2}, {"a": {"n": 3, "m": 3}, "b": 1}
    assert _with_grown(before, now, ("a.n", "b", "c.d")) == {"a": {"n": 3, "m": 1}, "b": 2}
