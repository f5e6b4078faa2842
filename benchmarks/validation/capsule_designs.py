"""Coverage of a stomach over time: one policy and one planner with four capsule designs.

Writes a section of docs/results/validation.md and docs/images/capsule_designs.png. Interrupted, the
same command resumes.

    python -m benchmarks.validation.capsule_designs [--size SEEDS] [--run FOLDER]
"""

from __future__ import annotations

import csv
from pathlib import Path

from benchmarks.common.scripts import ROOT, parser, table, write_section
from vrcaps.cli.policy import Evaluate
from vrcaps.core.files import write_bytes
from vrcaps.tools.reports.evaluation import PICTURE, TABLE

POLICIES = ("coverage-ppo", "next-best-view")
CAPSULES = ("mono", "stereo", "dual", "panoramic")
FIGURES = (
    "visible at 47.62 s [%]",
    "resolved at 47.62 s [%]",
    "area under curve [%]",
    "time to 90 % [s]",
    "time to 95 % [s]",
)
IMAGE = ROOT / "docs" / "images" / "capsule_designs.png"


def main() -> None:
    """Evaluate all designs, write the table and the picture."""
    made = parser(__doc__ or "")
    made.add_argument("--size", type=int, default=20, help="seeds, of two episodes each")
    made.add_argument("--run", type=Path, default=ROOT / "build" / "designs", help="folder")
    given = made.parse_args()
    rows = []
    for policy in POLICIES:
        folder = given.run / policy
        judging = Evaluate(
            (policy,), folder, capsules=CAPSULES, seeds=given.size, episodes=2,
            dynamics="quasi-static", video=False,
        )  # fmt: skip
        judging.run()
        rows += design_rows(policy, folder / TABLE)
    write_bytes(IMAGE, (given.run / POLICIES[0] / PICTURE).read_bytes())
    text = f"""## Capsule designs

`python -m benchmarks.validation.capsule_designs`: {given.size} seeds of two episodes of 60 s in
stomachs 100 to 119, quasi-static dynamics. Medians over episodes, with 10th to 90th percentile,
or the number of episodes that reached the value. The policy was trained with the one camera of
`magnetic`; it observes the unseen area of all cameras.

{table(("policy", "capsule", *FIGURES), rows)}

![Coverage over time by design](../images/{IMAGE.name})"""
    write_section(given.out, Path(__file__), text)


def design_rows(policy: str, path: Path) -> list[tuple[str, ...]]:
    """Rows of one policy, one per design."""
    with path.open(newline="") as file:
        found = {row["figure"]: row for row in csv.DictReader(file)}
    return [
        (policy, capsule, *(found[figure][f"{policy} {capsule}"] for figure in FIGURES))
        for capsule in CAPSULES
    ]


if __name__ == "__main__":
    main()
