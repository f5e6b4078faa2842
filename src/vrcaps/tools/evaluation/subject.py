"""Subject: a policy with a capsule as it was judged, and its figures."""

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
"""Figure whose median run is shown."""


@dataclass(frozen=True)
class Subject:
    """What was judged.

    Attributes:
        name: Of the policy, and of the capsule where several are compared.
        evaluation: Its episodes.
        settings: Of the environment.
    """

    name: str
    evaluation: Evaluation
    settings: EnvSettings

    @property
    def judged_at(self) -> float:
        """Time at which coverage is told [s]."""
        return judged_time(self.settings.episode_time)

    @property
    def has_goal(self) -> bool:
        """Whether its task is to get somewhere or find something, and then done."""
        return self.settings.task.kind != "coverage"


def summary(subject: Subject) -> dict[str, str]:
    """Medians over all episodes by name, with 10th and 90th percentile of coverage."""
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
    """Share of episodes whose task was done, with its confidence interval, and how long it took."""
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
    """Organ of each episode: episodes in one are alike. None where all are in the same."""
    organs = evaluation.column("organ")
    return organs if len(np.unique(organs)) > 1 else None


def median_time(times: np.ndarray) -> float:
    """Median of times [s], where one that was never reached is the longest."""
    return float(np.median(np.where(np.isnan(times), np.inf, times)))


def time_text(times: np.ndarray) -> str:
    """Median time, where one that was never reached is the longest, and how many reached it."""
    middle = median_time(times)
    reached = f"{np.isfinite(times).sum()}/{len(times)}"
    return f"{middle:.1f} ({reached})" if np.isfinite(middle) else f"not ({reached})"


def ends(subject: Subject) -> dict[str, int]:
    """How many episodes ended for each reason."""
    names, counts = np.unique(subject.evaluation.column("end"), return_counts=True)
    return dict(zip(names.tolist(), counts.tolist(), strict=True))
