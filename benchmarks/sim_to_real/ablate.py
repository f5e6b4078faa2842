"""Claim: networks for real images need the components of the simulator: an ablation.

Makes the images of one small plan again without indirect light, without effects of lens and sensor,
with a wall of one color, with an empty lumen, and with polyps that differ by color alone (Paris
IIb). Networks are pre-trained on each and fine-tuned on a tenth of the real images; those for depth
see no real image. The table shows the changes of their metrics.

    python -m benchmarks.sim_to_real.ablate --real /data/endoscopy --run runs/ablations --workers 2
    python -m benchmarks.sim_to_real.ablate --run runs/ablations --report   # the page, as it stands

Each network is one row of `rows.jsonl`; the same command resumes after an interruption.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.common.scripts import table
from benchmarks.sim_to_real.ablations import (
    COMPLETE,
    FRACTION,
    PATIENTS,
    VARIANTS,
    ablation_cells,
    made_variants,
)
from benchmarks.sim_to_real.cells import Cell, Row, RowFile
from benchmarks.sim_to_real.options import check_tasks, experiment_parser
from benchmarks.sim_to_real.page import (
    DEPTH_TITLES,
    PAGE,
    Found,
    about,
    by_arm,
    difference_of,
    interval_of,
    interval_of_networks,
    shown_interval,
    write_part,
)
from benchmarks.sim_to_real.real import found_layouts
from benchmarks.sim_to_real.run import DEPTH_READERS, complete_cells
from benchmarks.sim_to_real.setup import Setup
from benchmarks.sim_to_real.tasks import DEPTH, TASKS
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.metrics.bootstrap import Interval

MODULE = "benchmarks.sim_to_real.ablate"
COMMAND = f"python -m {MODULE} --run runs/ablations --report"


def main() -> None:
    """Run the missing cells, then write the page."""
    given = experiment_parser(__doc__ or "", PAGE, preset="short").parse_args()
    try:
        rows = RowFile(given.run)
        if not given.report:
            run(given, rows)
    except VrcapsError as error:
        sys.exit(str(error))
    text = page_text(list(rows.rows.values()))
    write_part(given.out, MODULE, text, COMMAND)


def run(given: argparse.Namespace, rows: RowFile) -> None:
    """Make the data sets and run the networks that are missing.

    Raises:
        InputError: If there is no data for a requested task.
    """
    check_tasks(given.tasks)
    real = found_layouts(given.real, given.layout)
    cells = cells_of(given.tasks, [*real], given.seeds)
    variants = {name: str(given.run / "variants" / folder) for name, folder in VARIANTS.items()}
    made_variants(given.run, given.workers)
    setup = Setup(real, given.run, preset=given.preset, device=given.device, variants=variants)
    complete_cells(setup, cells, rows, given.workers)


def cells_of(tasks: Sequence[str], layouts: Sequence[str], seeds: int) -> list[Cell]:
    """Networks of the tasks with real data.

    Raises:
        InputError: If there is none.
    """
    chosen = [
        name
        for name, task in TASKS.items()
        if name in tasks and task.layout in layouts and task.kind != "super-resolution"
    ]
    if DEPTH in tasks and {*DEPTH_READERS} & {*layouts}:
        chosen.append(DEPTH)
    if not chosen:
        raise InputError("There is no data for these tasks. Give --real or --layout.")
    return ablation_cells(chosen, seeds)


def page_text(rows: Sequence[Row]) -> str:
    """Section of the page: changes by missing component."""
    found = by_arm(rows)
    names = [name for name in TASKS if (name, "ours", FRACTION, COMPLETE) in found]
    titles = [f"{TASKS[name].title}: {TASKS[name].figure}" for name in names]
    seeds = len({row.cell.seed for row in rows})
    parts = [
        "## Simulator ablation: results",
        about(rows),
        f"All our images show the same patients, {PATIENTS} at most. Up to {seeds} networks of "
        "each kind; an interval over few of them is too narrow. Each network was trained first "
        "on images that lack one thing, from different random weights; then on a tenth of "
        "the real images. The first row is the metric of networks whose images lack nothing, the "
        "others are changes on the same real images.",
        table(["without", *titles], table_rows(found, names)),
    ]
    figures = [name for name in DEPTH_TITLES if _has_depth(found, name)]
    if figures:
        body = [[variant, *depth_cells(found, variant, figures)] for variant in VARIANTS]
        parts += [
            "Depth on real frames, of which the networks saw none, after scaling by medians; a "
            "smaller AbsRel is better. Intervals are over networks only.",
            table(["without", *(DEPTH_TITLES[name] for name in figures)], body),
        ]
    return "\n\n".join(parts)


def table_rows(found: Found, names: Sequence[str]) -> list[list[str]]:
    """Metrics [%] of networks trained on complete images, then changes [points]."""
    of = {
        (name, variant): found.get((name, "ours", FRACTION, variant), {})
        for name in names
        for variant in VARIANTS
    }
    first = [shown_interval(interval_of(TASKS[n], of[n, COMPLETE]), 100.0, 1) for n in names]
    body = [[COMPLETE, *first]]
    for variant in VARIANTS:
        if variant != COMPLETE:
            changes = [difference_of(TASKS[n], of[n, variant], of[n, COMPLETE]) for n in names]
            body.append([variant, *("" if c is None else _change(c) for c in changes)])
    return body


def _change(interval: Interval, scale: float = 100.0, digits: int = 1) -> str:
    """Change; bold if its interval excludes 0."""
    shown = shown_interval(interval, scale, digits, "+")
    return f"**{shown}**" if interval.low * interval.high > 0.0 else shown


def _has_depth(found: Found, figure: str) -> bool:
    rows = found.get((DEPTH, "ours", 0.0, COMPLETE), {})
    return any(figure in row.values for row in rows.values())


def depth_cells(found: Found, variant: str, figures: Sequence[str]) -> list[str]:
    """Metrics of depth, or their changes, of networks with the same seed."""
    own, full = (found.get((DEPTH, "ours", 0.0, one), {}) for one in (variant, COMPLETE))
    seeds = [seed for seed in sorted(own) if seed in full]
    if not seeds:
        return ["" for _ in figures]
    means = [
        [[float(np.mean(rows[seed].values[name])) for seed in seeds] for name in figures]
        for rows in (own, full)
    ]
    if variant == COMPLETE:
        return [str(interval_of_networks(column)) for column in means[0]]
    changes = [
        interval_of_networks([a - b for a, b in zip(*pair, strict=True)])
        for pair in zip(*means, strict=True)
    ]
    return [_change(one, 1.0, 3) for one in changes]


if __name__ == "__main__":
    main()
