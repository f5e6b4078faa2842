"""Report of a policy evaluation: metrics, table, plot and HTML page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.files import write_bytes, write_csv
from vrcaps.metrics.bootstrap import bootstrap, mean_band
from vrcaps.metrics.point_coverage import POINT_LEVELS
from vrcaps.policy.evaluation import PAPER_COVERAGE, PAPER_TIME, TARGETS, Evaluation, reported_time
from vrcaps.tools.report import (
    data_url,
    html_image,
    html_note,
    html_page,
    html_table,
    make_figure,
    png_bytes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from vrcaps.env.settings import EnvSettings

MEDIAN_OF = "visible_area_under_curve"
"""Metric that determines the median run."""


@dataclass(frozen=True)
class Subject:
    """Evaluated policy.

    Attributes:
        name: Name of the policy, and of the capsule if several are compared.
        evaluation: Its episodes.
        settings: Settings of the environment.
    """

    name: str
    evaluation: Evaluation
    settings: EnvSettings

    @property
    def evaluation_time(self) -> float:
        """Time at which coverage is reported [s]."""
        return reported_time(self.settings.episode_time)

    @property
    def has_goal(self) -> bool:
        """True if the task has a goal, such as a position or a lesion, that ends the episode."""
        return self.settings.task.kind != "coverage"


def summary(subject: Subject) -> dict[str, str]:
    """Medians over all episodes by metric; coverage with its 10th and 90th percentile."""
    evaluation = subject.evaluation
    row = {"episodes": str(len(evaluation.rows))}
    if subject.has_goal:
        row |= _success(evaluation)
    row["path length [m]"] = f"{np.median(evaluation.column('path_length_m')):.2f}"
    escapes = int(evaluation.column("wall_escapes").sum())
    for level in POINT_LEVELS:
        percent = evaluation.column(f"{level}_at_{subject.evaluation_time:g}_s")
        low, middle, high = np.percentile(percent, (10, 50, 90))
        column = f"{level} at {subject.evaluation_time:g} s [%]"
        row[column] = f"{middle:.1f} ({low:.1f} to {high:.1f})"
    row["visible at the end [%]"] = f"{np.median(evaluation.column('visible_at_end')):.1f}"
    row["area under curve [%]"] = f"{np.median(evaluation.column('visible_area_under_curve')):.1f}"
    for target in TARGETS:
        times = evaluation.column(f"visible_time_to_{target:g}_s")
        row[f"time to {target:g} % [s]"] = time_text(times)
    for name in ("p50", "p99", "max"):
        force = np.median(evaluation.column(f"force_{name}_n"))
        row[f"force {name} [mN]"] = f"{1e3 * force:.1f}"
    row["wall escapes"] = f"{escapes} ({100.0 * escapes / len(evaluation.rows):.1f} %)"
    return row


def _success(evaluation: Evaluation) -> dict[str, str]:
    """Success rate with its confidence interval, and time to success."""
    done = evaluation.column("success")
    spread = bootstrap(
        lambda items: float(done[items].mean()), len(done), groups=organs_of(evaluation)
    )
    share = f"{100.0 * spread.value:.1f} ({100.0 * spread.low:.1f} to {100.0 * spread.high:.1f})"
    return {
        "success [%]": share,
        "time to success [s]": time_text(evaluation.column("time_to_success_s")),
        "progress at the end [%]": f"{np.median(evaluation.column('progress_at_end')):.1f}",
    }


def organs_of(evaluation: Evaluation) -> np.ndarray | None:
    """Organ of each episode, as those in one organ are correlated. None if all are in the same."""
    organs = evaluation.column("organ")
    return organs if len(np.unique(organs)) > 1 else None


def median_time(times: np.ndarray) -> float:
    """Median of times [s]; a goal that was never reached counts as the longest time."""
    return float(np.median(np.where(np.isnan(times), np.inf, times)))


def time_text(times: np.ndarray) -> str:
    """Format the median time, with goals never reached as longest, and how many were reached."""
    middle = median_time(times)
    reached = f"{np.isfinite(times).sum()}/{len(times)}"
    return f"{middle:.1f} ({reached})" if np.isfinite(middle) else f"not ({reached})"


def ends(subject: Subject) -> dict[str, int]:
    """Number of episodes by end reason."""
    names, counts = np.unique(subject.evaluation.column("end"), return_counts=True)
    return dict(zip(names.tolist(), counts.tolist(), strict=True))


COLORS = ("#3b6fb6", "#e0982f", "#1a8a4a", "#a23b72", "#7f5f3f", "#5f5f5f", "#27a5a5", "#c44536")
"""Colors of the subjects, in turn."""

_SIZE_INCH, _DPI = (14.0, 8.2), 110
_POINTS = 241


def summary_picture(subjects: Sequence[Subject]) -> bytes:
    """Draw all subjects side by side, as a PNG."""
    fig = make_figure(*_SIZE_INCH)
    grid = fig.add_gridspec(2, 3, height_ratios=[1.3, 1.0])
    for column in range(len(POINT_LEVELS)):
        _draw_over_time(fig.add_subplot(grid[0, column]), subjects, column)
    _draw_coverage(fig.add_subplot(grid[1, :2]), subjects)
    _draw_times(fig.add_subplot(grid[1, 2]), subjects)
    handles = fig.axes[0].get_legend_handles_labels()
    fig.legend(*handles, loc="outside upper center", ncols=min(len(subjects), 5), frameon=False)
    return png_bytes(fig, _DPI)


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
    view.axvline(subjects[0].evaluation_time, color="#999999", lw=0.8, ls=":")
    view.set(title=level, xlabel="time [s]", ylim=(0, 101), xlim=(0, whole))
    view.set_ylabel("coverage [%]" if column == 0 else "")
    view.grid(alpha=0.3)


def _draw_coverage(view: Axes, subjects: Sequence[Subject]) -> None:
    """Draw bars of coverage at the evaluation time: median and range of most episodes."""
    time = subjects[0].evaluation_time
    width = 0.8 / len(subjects)
    for number, subject in enumerate(subjects):
        columns = [subject.evaluation.column(f"{lv}_at_{time:g}_s") for lv in POINT_LEVELS]
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
    view.set_title(f"coverage at {time:g} s: median, 10th to 90th percentile", size=10)
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


PAGE, PICTURE, TABLE, VIDEO = "index.html", "summary.png", "summary.csv", "median.mp4"

_NOTE = f"""Coverage is measured at points on the wall that stand for its area. <i>frustum</i>
counts vertices in the field of view, even through walls (the definition of VR-Caps); <i>visible</i>
counts the unoccluded wall; <i>resolved</i> counts the wall also seen at a small distance and angle.
Coverage stays constant after the end of an episode. Lines: mean over episodes with its 95 %
confidence band, by 1,000 bootstrap samples of whole organs (of episodes if there is one organ).
Pale: 10th to 90th percentile. Star: VR-Caps, {PAPER_COVERAGE} % at {PAPER_TIME} s in one stomach.
Times: median over episodes, where an episode that did not reach the target counts as the longest,
and the number of episodes that reached it. Forces: median over episodes of percentiles over the
actions of an episode."""


def write_page(folder: Path, subjects: Sequence[Subject]) -> list[Path]:
    """Write the page, the plot and the table.

    Args:
        folder: Output folder.
        subjects: Evaluated policies; each has the video of its median run in its folder, if made.

    Returns:
        Paths of the files.
    """
    write_bytes(folder / PICTURE, summary_picture(subjects))
    columns = {subject.name: summary(subject) for subject in subjects}
    names = next(iter(columns.values()))
    rows = [
        {"figure": name, **{subject: column[name] for subject, column in columns.items()}}
        for name in names
    ]
    write_csv(folder / TABLE, rows)
    write_bytes(folder / PAGE, _page(folder, subjects, rows))
    return [folder / name for name in (PAGE, PICTURE, TABLE)]


def _page(folder: Path, subjects: Sequence[Subject], rows: list[dict[str, str]]) -> bytes:
    dynamics = ", ".join(sorted({subject.settings.dynamics for subject in subjects}))
    by_organ = _by_organ(subjects)
    organs = [row["organ"] for row in by_organ]
    whole = ", ".join(sorted({f"{s.settings.episode_time:g}" for s in subjects}))
    summary_line = (
        f"{len(organs)} organs ({', '.join(organs[:4])}{', …' if len(organs) > 4 else ''}); "
        f"episodes of {whole} s; dynamics: {dynamics}."
    )
    parts = [
        f"<h1>Evaluation of {html.escape(', '.join(s.name for s in subjects))}</h1>",
        f"<p>{html.escape(summary_line)}</p>",
        html_image("coverage", (folder / PICTURE).read_bytes()),
        html_note(_NOTE),
        html_table(rows),
        "<h2>Organs</h2>",
        html_note(f"Median visible coverage at {subjects[0].evaluation_time:g} s [%]."),
        html_table(by_organ),
        f"<h2>Episode outcomes</h2>{html_table(_ends(subjects))}",
    ]
    for subject in subjects:
        video = subject.evaluation.folder / VIDEO
        if video.is_file():
            source = data_url(video.read_bytes(), "video/mp4")
            row = subject.evaluation.median_row(MEDIAN_OF)
            parts.append(
                f"<h2>{html.escape(subject.name)}: median run</h2>"
                f"<p>{row['organ']}, seed {row['seed']}, episode {row['episode']}; at twice "
                "real time. Left: camera. Right: organ, with the seen wall in green.</p>"
                f"<video controls loop muted src='{source}'></video>"
            )
    return html_page("Evaluation", parts)


def _by_organ(subjects: Sequence[Subject]) -> list[dict[str, str]]:
    """One row per organ, one column per subject."""
    names = sorted({str(o) for s in subjects for o in s.evaluation.column("organ")})
    rows = []
    for name in names:
        row = {"organ": name}
        for subject in subjects:
            own = subject.evaluation.column("organ") == name
            percent = subject.evaluation.column(f"visible_at_{subject.evaluation_time:g}_s")[own]
            row[subject.name] = f"{np.median(percent):.1f}" if len(percent) else ""
        rows.append(row)
    return rows


def _ends(subjects: Sequence[Subject]) -> list[dict[str, str]]:
    """One row per subject: number of episodes by end reason."""
    counts = [ends(subject) for subject in subjects]
    reasons = sorted({reason for count in counts for reason in count})
    return [
        {"policy": subject.name, **{r: str(count.get(r, 0)) for r in reasons}}
        for subject, count in zip(subjects, counts, strict=True)
    ]
