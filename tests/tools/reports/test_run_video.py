"""Video of a run: what was seen until each moment, and a picture of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.small_envs import SHORT_GUT, small_settings
from vrcaps.capsule.device_file import read_device
from vrcaps.env.actuation import Wrench
from vrcaps.env.settings import EnvSettings
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.evaluate import Plan, evaluate
from vrcaps.policy.evaluation import Evaluation
from vrcaps.recording.pictures import require_preview
from vrcaps.tools.reports import run_video
from vrcaps.tools.reports.evaluation import Subject, ends, summary, time_text
from vrcaps.tools.reports.run_video import faces_first_seen, write_run_video
from vrcaps.world.model import Model


def test_faces_are_first_seen_where_the_camera_first_looks() -> None:
    """From the middle of a tube: first the half ahead, then the half behind."""
    model = Model(SHORT_GUT, read_device("magnetic"))
    poses = np.stack(
        [model.place(0.06).T_world_capsule, model.place(0.06, angle=np.pi).T_world_capsule]
    )
    first = faces_first_seen(small_settings(), model, poses)
    x = SHORT_GUT.arc_length[SHORT_GUT.faces].mean(axis=1)
    along = (x > 0.075) & (x < 0.115)
    back = (x > 0.005) & (x < 0.045)
    assert (first[along] == 0).mean() > 0.9
    assert (first[back] == 1).mean() > 0.9
    assert not (first[back] == 0).any()


@pytest.mark.slow
def test_a_video_of_the_median_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera's own picture is left out: a bare tube's texture would have to be baked."""
    black = np.zeros((360, 360, 3), np.uint8)
    monkeypatch.setattr(run_video, "Renderer", lambda *_: None)
    monkeypatch.setattr(run_video, "exposed_image", lambda *_: black)
    patients = EnvSettings.patients
    monkeypatch.setattr(EnvSettings, "patients", lambda s, **_: patients(s, with_textures=False))
    settings = small_settings(
        organs=(SHORT_GUT,),
        actuation=Wrench(is_weightless=True),
        dynamics="physics",
        episode_time=0.5,
    )
    evaluation = Evaluation(tmp_path, {})
    evaluate(read_policy("centerline"), settings, Plan(1, 1), evaluation)
    subject = Subject("centerline", evaluation, settings)
    write_run_video(tmp_path / "median.mp4", subject)
    require_preview(tmp_path / "median.mp4", 2)
    assert summary(subject)["wall escapes"] == "0 (0.0 %)"
    assert "success [%]" not in summary(subject)
    assert ends(subject) == {"time": 1}


def test_a_time_that_half_never_reached_is_none() -> None:
    assert time_text(np.array([3.0, 5.0, np.nan])) == "5.0 (2/3)"
    assert time_text(np.array([3.0, np.nan, np.nan])) == "not (1/3)"
