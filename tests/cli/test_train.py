"""`vrcaps train`: settings from presets and flags, and a run from the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.small_envs import SHORT_GUT, small_settings
from vrcaps.cli import main
from vrcaps.cli.policy import Coverage
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.env.patients import parse_organs
from vrcaps.policy.training import PRESETS, TrainingSettings, ci, paper
from vrcaps.scenario.scenario import OrganFile, OrganGenerated

OUT = Path("unused")


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_training(name: str) -> None:
    assert isinstance(PRESETS[name](), TrainingSettings)


def test_the_papers_preset_states_the_papers_figures() -> None:
    """Incetan et al. 2021, section on area coverage."""
    env, learner = paper().env, paper().learner
    assert round(env.episode_time * 30.0) == 7500
    assert learner.hidden == (256, 256, 256)
    assert (learner.batch, learner.learning_rate, learner.num_actions) == (64, 3e-4, 500_000)
    assert len(env.organs) == 3


def test_flags_change_the_preset() -> None:
    flags = Coverage(
        OUT,
        organ=("stomach:3-5", "mine.ply:mm"),
        actions=1000,
        envs=4,
        seed=2,
        set=("learner.epochs=3", "env.actuation.force=0.05", 'env.observations=["state"]'),
    )
    settings = flags.settings()
    assert (settings.learner.num_actions, settings.learner.num_envs) == (1000, 4)
    assert (settings.learner.epochs, settings.seed) == (3, 2)
    assert settings.env.actuation.force == 0.05  # type: ignore[union-attr]
    assert [o.name for o in settings.env.observations] == ["state"]
    assert settings.env.organs[:3] == tuple(OrganGenerated("stomach", seed=s) for s in (3, 4, 5))
    assert settings.env.organs[3] == OrganFile("mine.ply", unit="mm")


def test_a_part_is_chosen_by_its_kind() -> None:
    settings = Coverage(OUT, set=("env.actuation=wrench", "env.task=coverage")).settings()
    assert settings.env.actuation.force == 0.02  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("flags", "error", "said"),
    [
        ({"set": ("learner.epoch=3",)}, UnknownNameError, "No setting named 'epoch'. Known:"),
        ({"set": ("learner.epochs.x=3",)}, UnknownNameError, "No setting named 'x'"),
        ({"set": ("env.actuation=tractor",)}, UnknownNameError, "No actuation named 'tractor'"),
        ({"set": ("learner.epochs=0",)}, InputError, "epochs is 0. Allowed: 1 or more"),
        ({"set": ("learner.epochs=many",)}, InputError, "epochs is 'many'"),
        ({"organ": ("stomach:x",)}, InputError, "Allowed: NAME:SEED, NAME:FIRST-LAST, FILE:UNIT"),
    ],
)
def test_bad_flags_are_one_line(flags: dict, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said) as caught:
        Coverage(OUT, **flags).settings()
    assert "\n" not in str(caught.value)


def test_organs_without_seed_or_unit() -> None:
    assert parse_organs("stomach") == [OrganGenerated("stomach")]
    assert parse_organs("mine.glb") == [OrganFile("mine.glb")]


@pytest.mark.slow
def test_a_run_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("stable_baselines3")
    ours = ci()
    env = small_settings(
        organs=(SHORT_GUT,), control_period=0.01, episode_time=0.04, num_points=256
    )
    learner = replace(ours.learner, num_actions=8, evaluate_every=1)
    monkeypatch.setitem(PRESETS, "ci", lambda: TrainingSettings(env, learner))
    main(["train", "coverage", "--out", str(tmp_path / "run"), "--preset", "ci", "--tensorboard"])
    said = capsys.readouterr().out
    assert "round 1 of 1, 8 actions, " in said
    assert "; evaluated: " in said
    assert "best.npz after 1 rounds" in said
    assert list((tmp_path / "run" / "tensorboard").glob("events*"))
