"""Subject of an evaluation: a policy with a capsule, and its metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.metrics.bootstrap import bootstrap
from vrcaps.metrics.point_coverage import POINT_LEVELS
from vrcaps.policy.evaluation import TARGETS, Evaluation, judged_time

if TYPE_CHECKING:
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
    def judged_at(self) -> float:
        """Time at which coverage is reported [s]."""
        return judged_time(self.settings.episode_time)

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
        percent = evaluation.column(f"{level}_at_{subject.judged_at:g}_s")
        low, middle, high = np.percentile(percent, (10, 50, 90))
        row[f"{level} at {subject.judged_at:g} s [%]"] = f"{middle:.1f} ({low:.1f} to {high:.1f})"
    row["visible at end [%]"] = f"{np.median(evaluation.column('visible_at_end')):.1f}"
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
        "progress at end [%]": f"{np.median(evaluation.column('progress_at_end')):.1f}",
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
