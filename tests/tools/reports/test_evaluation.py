"""Figures of a subject: success with an interval over organs, and times that were judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.support.small_envs import small_settings
from vrcaps.env.tasks import NavigateTask
from vrcaps.policy.evaluation import (
    EpisodeCurves,
    Evaluation,
    episode_measures,
    success_measures,
)
from vrcaps.tools.reports.evaluation import Subject, summary


def test_success_with_an_interval_over_organs(tmp_path: Path) -> None:
    """Two organs of ten episodes: all succeed in one, none in the other. Draws of organs give 0,
    50 or 100 %; draws of single episodes would give 30 to 70 %."""
    evaluation, curves = Evaluation(tmp_path, {}), []
    for number in range(20):
        time = np.array([0.0, 3.0])
        curve = EpisodeCurves(time, np.zeros((2, 3)), time, time, np.eye(2, 7))
        is_success = number < 10
        row = {"seed": number, "episode": 0, "organ": f"gut:{int(is_success)}", "wall_escapes": 0}
        row |= success_measures(curve, 0.5 + 0.5 * is_success, is_success=is_success)
        curves.append((row | episode_measures(curve, 4.0), curve))
    evaluation.add(*map(list, zip(*curves, strict=True)))
    settings = small_settings(task=NavigateTask(), episode_time=4.0)
    found = summary(Subject("mine", evaluation, settings))
    assert found["success [%]"] == "50.0 (0.0 to 100.0)"
    assert found["time to success [s]"] == "not (10/20)"
    assert found["progress at the end [%]"] == "75.0"
    assert "visible at 4 s [%]" in found
