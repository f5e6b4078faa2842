"""`vrcaps evaluate`: settings of what is judged, a run from the command line, and bad input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.small_envs import SHORT_GUT, small_settings
from vrcaps.cli import main
from vrcaps.cli.policy import Evaluate
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.env.actuation import MagnetActuation, Wrench
from vrcaps.env.settings import EnvSettings
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.policy import Requirements
from vrcaps.tools.reports.evaluation import PAGE, PICTURE, TABLE


def test_an_episode_goes_on_to_the_end_of_its_time() -> None:
    command = Evaluate(("centerline",), Path("unused"), organs=("stomach:3-4",), time=50.0)
    settings = command._settings(read_policy("centerline"), "dual")
    assert settings.task.target == 1.0
    assert settings.stuck_time > settings.episode_time == 50.0
    assert settings.dynamics == "physics"
    assert settings.actuation == Wrench(is_weightless=True)
    assert settings.capsule == "dual"
    assert [organ.seed for organ in settings.organs] == [3, 4]  # type: ignore[union-attr]


def test_each_task_has_its_organ_its_time_and_its_actuation() -> None:
    def settings(task: str) -> EnvSettings:
        return Evaluate(("centerline",), Path("unused"), task=task)._settings(
            read_policy("centerline"), ""
        )

    coverage, navigate, inspect = (settings(t) for t in ("coverage", "navigate", "inspect"))
    assert {organ.name for organ in navigate.organs} == {"colon"}  # type: ignore[union-attr]
    assert [organ.seed for organ in inspect.organs] == list(range(100, 120))  # type: ignore[union-attr]
    assert [s.episode_time for s in (coverage, navigate, inspect)] == [60.0, 1200.0, 180.0]
    assert [s.actuation.kind for s in (coverage, navigate, inspect)] == [
        "wrench",
        "magnet",
        "wrench",
    ]
    assert len(inspect.lesions) == 3


@pytest.mark.parametrize("asked", ["", "magnet", "wrench"])
def test_the_kind_of_the_training_keeps_its_settings(asked: str) -> None:
    trained = MagnetActuation(speed=0.013)
    policy = read_policy("random")
    policy.requires = Requirements({"actuation": trained})  # pyright: ignore
    settings = Evaluate(("random",), Path("unused"), actuation=asked)._settings(policy, "")
    assert settings.actuation == (Wrench() if asked == "wrench" else trained)
    assert trained != MagnetActuation()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("", "No policy is given"),
        ("centreline", "No policy named 'centreline'"),
        ("nosuch", "Tasks on images: depth, segmentation, classification"),
        ("centerline --organs colom:0", "No organ named 'colom'"),
        ("centerline --organs no.glb", "no.glb"),
        ("centerline --task fly", "No task named 'fly'"),
        ("centerline --actuation arm", "the environment's actuation is arm"),
        ("centerline --capsules mirocan", "No capsule named 'mirocan'"),
        ("centerline --seeds 0", "seeds is 0"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    flags: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    with pytest.raises(SystemExit):
        main(["evaluate", *flags.split(), "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err.strip()
    assert said in error
    assert "\n" not in error
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_two_policies_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrench = Wrench(is_weightless=True)
    small = small_settings(
        organs=(SHORT_GUT,), actuation=wrench, dynamics="physics", episode_time=0.4
    )
    monkeypatch.setattr(Evaluate, "_settings", lambda *_: replace(small))
    policies = ("centerline", "vrcaps.policy.baselines:RandomPolicy")
    command = Evaluate(policies, tmp_path, seeds=2, episodes=1, video=False)
    command.run()
    page = (tmp_path / PAGE).read_text()
    assert "centerline" in page
    assert "data:image/png;base64," in page
    assert (tmp_path / PICTURE).read_bytes().startswith(b"\x89PNG")
    table = (tmp_path / TABLE).read_text().splitlines()
    assert table[0] == "figure,centerline,vrcaps.policy.baselines-RandomPolicy"
    assert table[-1] == "wall escapes,0 (0.0 %),0 (0.0 %)"
    assert table[3].startswith("frustum at 0.4 s [%],")
    assert "47.62 s" not in table[3] + (tmp_path / "centerline" / "episodes.csv").read_text()
    folders = {p.name for p in tmp_path.iterdir() if p.is_dir()}
    assert folders == {"centerline", "vrcaps.policy.baselines-RandomPolicy"}


def test_errors_are_the_packages_own() -> None:
    with pytest.raises(InputError) as caught:
        Evaluate((), Path("unused")).run()
    assert isinstance(caught.value, VrcapsError)
