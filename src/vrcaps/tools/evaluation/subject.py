"""Subject: a policy with a capsule as it was judged, and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.metrics.point_coverage import POINT_LEVELS
from vrcaps.policy.evaluation import PAPER_TIME, TARGETS, Evaluation

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


def summary(subject: Subject) -> dict[str, str]:
    """Medians over all episodes by name, with 10th and 90th percentile of coverage."""
    evaluation = subject.evaluation
    row = {"episodes": str(len(evaluation.rows))}
    for level in POINT_LEVELS:
        percent = evaluation.column(f"{level}_at_{PAPER_TIME}_s")
        low, middle, high = np.percentile(percent, (10, 50, 90))
        row[f"{level} at {PAPER_TIME} s [%]"] = f"{middle:.1f} ({low:.1f} to {high:.1f})"
    row["visible at end [%]"] = f"{np.median(evaluation.column('visible_at_end')):.1f}"
    row["area under curve [%]"] = f"{np.median(evaluation.column('visible_area_under_curve')):.1f}"
    for target in TARGETS:
        times = evaluation.column(f"visible_time_to_{target:g}_s")
        row[f"time to {target:g} % [s]"] = time_text(times)
    for name in ("p50", "p99", "max"):
        force = np.median(evaluation.column(f"force_{name}_n"))
        row[f"force {name} [mN]"] = f"{1e3 * force:.1f}"
    row["wall escapes"] = str(int(evaluation.column("wall_escapes").sum()))
    return row


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
