"""Judging: every episode once, the same after an interruption, and figures by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, small_settings
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import Wrench
from vrcaps.env.randomization import Start
from vrcaps.env.settings import EnvSettings
from vrcaps.env.tasks import NavigateTask
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.evaluate import Plan, evaluate
from vrcaps.policy.evaluation import (
    EPISODES,
    EpisodeCurves,
    Evaluation,
    episode_measures,
    read_rows,
    reported_time,
    success_measures,
)

STATED = {"policy": "centerline"}


def settings() -> EnvSettings:
    return small_settings(
        actuation=Wrench(is_weightless=True),
        dynamics="physics",
        organs=(GUT, SHORT_GUT),
        start=Start(settle=0.0),
        episode_time=0.5,
    )


@pytest.mark.slow
def test_an_interrupted_evaluation_goes_on_to_the_same_table(tmp_path: Path) -> None:
    """Episodes do not depend on those that run beside them, nor on when they run."""
    plan, policy = Plan(seeds=3, episodes=2, worlds=4), read_policy("centerline")
    whole = Evaluation(tmp_path / "whole", STATED)
    evaluate(policy, settings(), plan, whole)
    first = Evaluation(tmp_path / "parts", STATED)
    evaluate(policy, settings(), Plan(seeds=2, episodes=1, worlds=1), first)
    again = Evaluation(tmp_path / "parts", STATED)
    assert again.done == {(0, 0), (1, 0)}
    seen: list[tuple[int, int]] = []
    evaluate(policy, settings(), plan, again, lambda done, total: seen.append((done, total)))
    assert seen[0] == (2, 6)
    assert seen[-1] == (6, 6)
    texts = [(tmp_path / name / EPISODES).read_text() for name in ("whole", "parts")]
    assert texts[0] == texts[1]
    curve = again.episode_curves(again.rows[0])
    assert curve["time_s"].tolist() == pytest.approx([0.0, 1 / 6, 2 / 6, 3 / 6])
    assert {row["end"] for row in again.rows} == {"time"}


def test_a_folder_of_another_evaluation_is_refused(tmp_path: Path) -> None:
    Evaluation(tmp_path, STATED)
    with pytest.raises(InputError, match="another policy"):
        Evaluation(tmp_path, {"policy": "random"})


def test_a_table_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / EPISODES
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        read_rows(path)


def test_figures_of_a_curve_by_hand() -> None:
    """Seen: 0 %, 50 % after 10 s, 92 % after 20 s, then the episode is over; judged to 40 s."""
    fraction = np.array([0.0, 0.5, 0.92])[:, None].repeat(3, axis=1)
    curves = EpisodeCurves(
        np.array([0.0, 10.0, 20.0]), fraction, np.zeros(3), np.array([9.0, 0.1, 0.3]), np.eye(3, 7)
    )
    figures = episode_measures(curves, 40.0)
    assert figures["visible_at_40_s"] == figures["visible_at_end"] == pytest.approx(92.0)
    assert figures["visible_time_to_90_s"] == 20.0
    assert np.isnan(figures["visible_time_to_95_s"])
    assert figures["visible_area_under_curve"] == pytest.approx((0 + 50 * 10 + 92 * 20) / 40)
    assert figures["force_max_n"] == 0.3  # what pressed before the first action is not counted


def test_coverage_is_told_at_the_papers_time_or_at_the_end_of_shorter_episodes() -> None:
    assert (reported_time(60.0), reported_time(30.0)) == (47.62, 30.0)


def test_success_by_hand() -> None:
    """3 cm and 4 cm in 2 s, then the goal; the same without one."""
    pose = np.eye(3, 7)
    pose[:, :3] = [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.03, 0.04, 0.0]]
    curves = EpisodeCurves(
        np.array([0.0, 1.0, 2.0]), np.zeros((3, 3)), np.zeros(3), np.zeros(3), pose
    )
    found = success_measures(curves, 1.0, is_success=True)
    assert found["path_length_m"] == pytest.approx(0.07)
    assert (found["success"], found["time_to_success_s"], found["progress_at_end"]) == (1, 2, 100)
    failed = success_measures(curves, 0.4, is_success=False)
    assert (failed["success"], failed["progress_at_end"]) == (0, 40)
    assert np.isnan(failed["time_to_success_s"])


def test_a_goal_that_is_reached_is_a_success(tmp_path: Path) -> None:
    """Along a tube from its middle: the goal 2 cm on is reached, that of the other end is not."""
    rows = []
    for goal in (0.75, 1.0):
        task = NavigateTask(goal, tolerance=5e-3)
        start = Start(fraction=(0.6, 0.6), settle=0.0)
        env = replace(settings(), organs=(SHORT_GUT,), task=task, start=start, episode_time=1.5)
        evaluation = Evaluation(tmp_path / str(goal), STATED)
        evaluate(read_policy("centerline"), env, Plan(seeds=1, episodes=1), evaluation)
        rows += evaluation.rows
    assert [row["success"] for row in rows] == [1, 0]
    assert [row["end"] for row in rows] == ["done", "time"]
    assert 0.0 < rows[0]["time_to_success_s"] < 1.5
    assert 0.01 < rows[0]["path_length_m"] < 0.03
    assert rows[0]["progress_at_end"] == 100 > rows[1]["progress_at_end"] > 0


def test_coverage_over_time_holds_after_the_end(tmp_path: Path) -> None:
    evaluation = Evaluation(tmp_path, STATED)
    for seed, last in enumerate((0.4, 0.8)):
        fraction = np.array([0.2, last])[:, None].repeat(3, axis=1)
        curves = EpisodeCurves(
            np.array([0.0, 1.0]), fraction, np.zeros(2), np.zeros(2), np.eye(2, 7)
        )
        row = {"seed": seed, "episode": 0, **episode_measures(curves, 4.0)}
        evaluation.add([row], [curves])
    found = evaluation.over_time("visible", np.array([0.5, 1.0, 3.0]))
    assert found == pytest.approx(np.array([[20.0, 40.0, 40.0], [20.0, 80.0, 80.0]]))
    assert evaluation.median_row("visible_at_end")["seed"] == 1
