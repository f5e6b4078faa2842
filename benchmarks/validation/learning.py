"""Claim: the trained policy covers held-out stomachs better than planners that know them.

Evaluates the policy of the package, and baselines, under full physics in twenty generated stomachs
held out from its training. If interrupted, the same command resumes.

    python -m benchmarks.validation.learning [--size SEEDS] [--run FOLDER]
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.scripts import ROOT, parser, table, write_section
from vrcaps.cli.policy import Evaluate
from vrcaps.metrics.bootstrap import bootstrap
from vrcaps.policy.evaluation import EPISODES, PAPER_COVERAGE, PAPER_TIME, read_rows

POLICIES = ("coverage-ppo", "next-best-view", "look-around", "centerline")
FIGURES = (
    ("frustum at 47.62 s", f"frustum_at_{PAPER_TIME:g}_s", "%"),
    ("visible", f"visible_at_{PAPER_TIME:g}_s", "%"),
    ("resolved", f"resolved_at_{PAPER_TIME:g}_s", "%"),
    ("mean visible over 60 s", "visible_area_under_curve", "%"),
    ("to 95 % visible", "visible_time_to_95_s", "s"),
    ("to 96.04 % frustum", f"frustum_time_to_{PAPER_COVERAGE:g}_s", "s"),
    ("largest force", "force_max_n", "mN"),
)
COMPARED = (
    ("visible at 47.62 s", f"visible_at_{PAPER_TIME:g}_s"),
    ("resolved at 47.62 s", f"resolved_at_{PAPER_TIME:g}_s"),
    ("mean visible over 60 s", "visible_area_under_curve"),
)

Rows = list[dict[str, Any]]


def main() -> None:
    """Evaluate, write the tables."""
    made = parser(__doc__ or "")
    made.add_argument("--size", type=int, default=80, help="seeds, of five episodes each")
    made.add_argument("--run", type=Path, default=ROOT / "build" / "judged", help="folder")
    given = made.parse_args()
    Evaluate(POLICIES, given.run, seeds=given.size, video=False).run()
    judged = {name: read_rows(given.run / name / EPISODES) for name in POLICIES}
    head = ("policy", "episodes", *(name for name, *_ in FIGURES), "wall escapes")
    rows = [figures_row(name, found) for name, found in judged.items()]
    compared = [difference_row(name, judged) for name in POLICIES[1:]]
    text = f"""## Trained policy

`python -m benchmarks.validation.learning`: `vrcaps evaluate` under full physics in stomachs 100 to
119, at least {given.size} seeds of five episodes of 60 s. `coverage-ppo` was trained in stomachs
0 to 15 under quasi-static dynamics and observes landmarks; `next-best-view` knows the shape of each
organ. Medians over episodes, with 10th to 90th percentile; a value that was not reached counts as
the maximum time. VR-Caps states 96.04 % at 47.62 s by the definition *frustum*, in its training
stomach. These are not measurements of a device: gravity is balanced, an ideal actuator applies
any force and torque along six axes, and the policies read which parts of the wall are still
unseen, in the true shape of the organ.

{table(head, rows)}

Difference between `coverage-ppo` and another policy in the same episodes, in percentage points:
mean and 95 % interval of a bootstrap over organs.

{table(("less", *(name for name, _ in COMPARED)), compared)}"""
    write_section(given.out, Path(__file__), text)


def figures_row(name: str, rows: Rows) -> tuple[str, ...]:
    """A row of the table of policies."""
    cells = []
    for _, key, unit in FIGURES:
        values = np.array([row[key] for row in rows], float)
        values = np.where(np.isnan(values), np.inf, values) * (1e3 if unit == "mN" else 1.0)
        low, middle, high = np.quantile(values, (0.1, 0.5, 0.9), method="closest_observation")
        cells.append(f"{said(middle)} {unit} ({said(low)} to {said(high)})")
    return (name, str(len(rows)), *cells, str(sum(row["wall_escapes"] for row in rows)))


def said(value: float) -> str:
    """Value, or a note that it was not reached."""
    return f"{value:.1f}" if np.isfinite(value) else "not"


def difference_row(other: str, judged: dict[str, Rows]) -> tuple[str, ...]:
    """Row of the table of differences, over common episodes."""
    ours, theirs = (
        {(row["seed"], row["episode"]): row for row in judged[name]}
        for name in (POLICIES[0], other)
    )
    shared = sorted(ours.keys() & theirs.keys())
    organs = np.array([ours[key]["organ"] for key in shared])
    cells = []
    for _, figure in COMPARED:
        more = np.array([ours[key][figure] - theirs[key][figure] for key in shared])
        found = bootstrap(lambda items, more=more: more[items].mean(), len(more), groups=organs)
        cells.append(f"{found.value:+.2f} [{found.low:+.2f}, {found.high:+.2f}]")
    return (other, *cells)


if __name__ == "__main__":
    main()
