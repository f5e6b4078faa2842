"""Claim: a network is better on real images because it saw ours.

Trains networks for masks, classes and super-resolution on shares of real images, each time from
scratch, from ImageNet's weights, from weights that were learned on our images, and from ImageNet's
that went on with ours; judges them by images of folds that they saw nothing of, near copies
included. Networks for depth are judged on real frames without learning from any.

    vrcaps dataset make benchmarks/sim_to_real.toml --out runs/ours
    python benchmarks/sim_to_real.py --real /data/endoscopy --ours runs/ours --run runs/transfer
    python benchmarks/sim_to_real.py --run runs/transfer --report   # the page, of what is there

Each network is one row of `rows.jsonl`; the same command goes on where it was stopped, and computes
none twice. Folders of real data are found by their names below `--real`: WCEBleedGen, HyperKvasir,
Kvasir-SEG, BKAI-IGH NeoPolyp, C3VD, sinus endoscopy, UnityCam; others are named by
`--layout kvasir_seg=/data/my/polyps`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from transfer_ablations import VARIANTS, ablation_cells, made_variants
from transfer_cells import Cell, Row, RowFile, ordered_cells
from transfer_general import GENERAL
from transfer_page import report
from transfer_real import LAYOUTS, found_layouts
from transfer_run import (
    DEPTH,
    DEPTH_ARMS,
    DEPTH_TASK,
    ONE_NETWORK,
    WITHOUT_LEARNING,
    Setup,
    first_weights,
    is_possible,
    lacks,
    made_of,
    run_cell,
)
from transfer_tasks import FRACTIONS, PRESETS, TASKS, Task
from validation import ROOT
from vrcaps.errors import InputError, UnknownNameError, VrcapsError, require

PAGE = ROOT / "docs" / "sim-to-real.md"


def parsed() -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--run", type=Path, required=True, help="folder of the experiment: rows and weights")
    add("--real", type=Path, help="folder with folders of real data")
    names = ", ".join(LAYOUTS)
    add("--layout", action="append", default=[], help=f"NAME=FOLDER, NAME one of {names}")
    add("--ours", action="append", default=[], help="folder or URL of a data set; repeat for more")
    words = "folder of weights learned on ours: TASK-scratch.safetensors, TASK-imagenet.safetensors"
    add("--weights", type=Path, help=f"{words}; depth.safetensors is judged as it is")
    add("--preset", choices=tuple(PRESETS), default="quick", help="how long networks learn")
    add("--tasks", nargs="*", default=[*TASKS, DEPTH], help="default: all that there is data for")
    add("--fractions", nargs="*", type=float, default=FRACTIONS, help="of the real images")
    add("--seeds", type=int, default=5, help="networks of each kind")
    add("--workers", type=int, default=1, help="processes, each of one thread")
    add("--device", default="cpu", help="cpu, cuda or mps")
    add("--ablate", action="store_true", help="also learn on images that lack one thing each")
    add("--report", action="store_true", help="only write the page")
    add("--out", type=Path, default=PAGE, help="Markdown page to write into")
    return parser.parse_args()


def main() -> None:
    """Run what is missing, then write the page."""
    given = parsed()
    try:
        rows = RowFile(given.run)
        if not given.report:
            run(given, rows)
        report(list(rows.rows.values()), given.out)
    except VrcapsError as error:
        sys.exit(str(error))


def run(given: argparse.Namespace, rows: RowFile) -> None:
    """Run the cells that have no row.

    Raises:
        InputError: If there is no data for what is asked.
    """
    setup = Setup(
        found_layouts(given.real, given.layout),
        given.run,
        tuple(given.ours),
        given.weights,
        given.preset,
        given.device,
        {name: str(given.run / "variants" / folder) for name, folder in VARIANTS.items()},
    )
    cells = main_cells(given, setup)
    if given.ablate:
        made_variants(given.run, given.workers)
        cells += ablation_cells([name for name in TASKS if name in given.tasks], given.seeds)
    missing = [cell for cell in cells if not rows.has(cell, made_of(setup, cell))]
    print(f"{len(cells)} networks, {len(cells) - len(missing)} of them known.", flush=True)
    began = time.monotonic()
    for done, row in enumerate(made_rows(setup, missing, given.workers), 1):
        rows.add(row)
        left = (time.monotonic() - began) / done * (len(missing) - done) / 60.0
        note = f"{row.cell}: {row.seconds:.0f} s, {left:.0f} min left"
        print(f"{done}/{len(missing)} {note}", flush=True)


def main_cells(given: argparse.Namespace, setup: Setup) -> list[Cell]:
    """Cells of the tasks that there is data for."""
    for name in given.tasks:
        if name not in (*TASKS, DEPTH):
            raise UnknownNameError("task", name, (*TASKS, DEPTH))
    for fraction in given.fractions:
        require(0.0 < fraction <= 1.0, "A fraction", fraction, "above 0, at most 1")
    tasks = [t for t in TASKS.values() if t.name in given.tasks and t.layout in setup.real]
    arms = {task.name: possible_arms(setup, task) for task in tasks}
    cells = ordered_cells(arms, given.fractions, given.seeds) if arms else []
    if DEPTH in given.tasks and {"c3vd", "sinus"} & {*setup.real}:
        own = [
            Cell(DEPTH, arm, 0.0, seed)
            for seed in range(given.seeds)
            for arm in DEPTH_ARMS
            if is_possible(setup, DEPTH_TASK, arm) and (seed == 0 or arm not in ONE_NETWORK)
        ]
        # Two networks of each kind tell much, more tell how they vary.
        place = next((k for k, cell in enumerate(cells) if cell.fraction == 0.0), len(cells))
        cells[place:place] = [cell for cell in own if cell.seed < 2]
        cells += [cell for cell in own if cell.seed >= 2]
    if not cells:
        raise InputError("There is no data for these tasks. Give --real or --layout.")
    return cells


def possible_arms(setup: Setup, task: Task) -> list[str]:
    """Arms of a task that there are images for; says what our data set lacks."""
    arms = [arm for arm in task.arms if is_possible(setup, task, arm)]
    reason = lacks(setup, task) if "ours" in arms else ""
    if reason:
        print(f"{task.name} goes without ours: {reason}")
    return [arm for arm in arms if not (reason and arm.endswith("ours"))]


def made_rows(setup: Setup, cells: Sequence[Cell], workers: int) -> Iterator[Row]:
    """Rows of cells as they come: made in this process, or in several."""
    if workers < 2:
        yield from (run_cell(setup, cell) for cell in cells)
        return
    # Weights to begin with come first, so that no two processes learn the same.
    firsts = {(c.task, c.arm, c.variant, c.seed * (c.task == DEPTH)): c for c in cells}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        given = (*WITHOUT_LEARNING, GENERAL)
        wanted = [cell for cell in firsts.values() if cell.arm not in given]
        list(pool.map(first_weights, [setup] * len(wanted), wanted))
        for done in as_completed([pool.submit(run_cell, setup, cell) for cell in cells]):
            yield done.result()


if __name__ == "__main__":
    main()
