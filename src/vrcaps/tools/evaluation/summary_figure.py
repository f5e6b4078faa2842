"""Figure of an evaluation: coverage over time, coverage at the evaluation time, time to targets."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.metrics.bootstrap import mean_band
from vrcaps.metrics.point_coverage import POINT_LEVELS
from vrcaps.policy.evaluation import PAPER_COVERAGE, PAPER_TIME, TARGETS
from vrcaps.tools.evaluation.subject import Subject, median_time, organs_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = ("#3b6fb6", "#e0982f", "#1a8a4a", "#a23b72", "#7f5f3f", "#5f5f5f", "#27a5a5", "#c44536")
"""Colors of the subjects, in turn."""

_SIZE_INCH, _DPI = (14.0, 8.2), 110
_POINTS = 241


def summary_picture(subjects: Sequence[Subject]) -> bytes:
    """Draw all subjects side by side, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 3, height_ratios=[1.3, 1.0])
    for column in range(len(POINT_LEVELS)):
        _draw_over_time(figure.add_subplot(grid[0, column]), subjects, column)
    _draw_coverage(figure.add_subplot(grid[1, :2]), subjects)
    _draw_times(figure.add_subplot(grid[1, 2]), subjects)
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=min(len(subjects), 5), frameon=False)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=_DPI)
    return picture.getvalue()


def _draw_over_time(view: Axes, subjects: Sequence[Subject], column: int) -> None:
    """Draw the mean of each subject with its confidence band, and the range of most episodes."""
    level = POINT_LEVELS[column]
    whole = max(subject.settings.episode_time for subject in subjects)
    time = np.linspace(0.0, whole, _POINTS)
    for number, subject in enumerate(subjects):
        color = COLORS[number % len(COLORS)]
        percent = subject.evaluation.over_time(level, time)
        view.plot(time, percent.mean(axis=0), color=color, lw=1.8, label=subject.name)
        low, high = np.percentile(percent, (10, 90), axis=0)
        view.fill_between(time, low, high, color=color, alpha=0.10, lw=0)
        if len(percent) > 1:
            low, high = mean_band(percent, groups=organs_of(subject.evaluation))
            view.fill_between(time, low, high, color=color, alpha=0.25, lw=0)
    if level == "frustum" and whole >= PAPER_TIME:
        view.plot(PAPER_TIME, PAPER_COVERAGE, marker="*", ms=11, color="#222222", ls="")
        view.annotate(
            f"VR-Caps, {PAPER_COVERAGE} %",
            (PAPER_TIME, PAPER_COVERAGE),
            (-8, -18),
            ha="right",
            textcoords="offset points",
            size=8,
        )
    view.axvline(subjects[0].judged_at, color="#999999", lw=0.8, ls=":")
    view.set(title=level, xlabel="time [s]", ylim=(0, 101), xlim=(0, whole))
    view.set_ylabel("coverage [%]" if column == 0 else "")
    view.grid(alpha=0.3)


def _draw_coverage(view: Axes, subjects: Sequence[Subject]) -> None:
    """Draw bars of coverage at the evaluation time: median and range of most episodes."""
    judged = subjects[0].judged_at
    width = 0.8 / len(subjects)
    for number, subject in enumerate(subjects):
        columns = [subject.evaluation.column(f"{lv}_at_{judged:g}_s") for lv in POINT_LEVELS]
        low, middle, high = np.percentile(np.array(columns), (10, 50, 90), axis=1)
        at = np.arange(len(POINT_LEVELS)) + (number - 0.5 * (len(subjects) - 1)) * width
        view.bar(
            at,
            middle,
            0.92 * width,
            color=COLORS[number % len(COLORS)],
            alpha=0.85,
            yerr=[middle - low, high - middle],
            error_kw={"lw": 1, "ecolor": "#333333"},
        )
        for x, value in zip(at, middle, strict=True):
            view.text(x, 2.0, f"{value:.1f}", ha="center", size=8, color="white")
    view.set_xticks(range(len(POINT_LEVELS)), POINT_LEVELS)
    view.set(ylim=(0, 101), ylabel="coverage [%]")
    view.set_title(f"coverage at {judged:g} s: median, 10th to 90th percentile", size=10)
    view.grid(axis="y", alpha=0.3)


def _draw_times(view: Axes, subjects: Sequence[Subject]) -> None:
    """Draw median times to each target at `visible`; a cross at the end if half never reach it."""
    whole = max(subject.settings.episode_time for subject in subjects)
    for number, subject in enumerate(subjects):
        color = COLORS[number % len(COLORS)]
        for row, target in enumerate(TARGETS):
            times = subject.evaluation.column(f"visible_time_to_{target:g}_s")
            middle = median_time(times)
            y = row + (number - 0.5 * (len(subjects) - 1)) * 0.7 / len(subjects)
            marker = "o" if np.isfinite(middle) else "x"
            view.plot(min(middle, whole), y, color=color, ls="", ms=7, marker=marker)
    view.set_yticks(range(len(TARGETS)), [f"{target:g} %" for target in TARGETS])
    view.set(xlim=(0, 1.03 * whole), xlabel="time [s]", ylim=(len(TARGETS) - 0.5, -0.5))
    view.set_title("median time to visible coverage (×: not reached)", size=10)
    view.grid(alpha=0.3)
