"""Claim: pre-training on simulated images improves networks on real images.

Trains networks for segmentation, classification and super-resolution on fractions of the real
images, each initialized at random, from ImageNet weights, from weights pre-trained on simulated
images, and from ImageNet weights fine-tuned on simulated images. Evaluates them on held-out folds,
which contain no near copies of training images. Networks for depth are evaluated on real frames
without training on any.

    vrcaps dataset make benchmarks/sim_to_real/plan.toml --out runs/ours --units 0:60
    python -m benchmarks.sim_to_real --real /data/endoscopy --ours runs/ours --run runs/transfer
    python -m benchmarks.sim_to_real --run runs/transfer --report   # the page only

Each network is one row of `rows.jsonl`; the same command resumes after an interruption and
computes none twice. Folders of real data are located by their names below `--real`: WCEBleedGen,
HyperKvasir, Kvasir-SEG, BKAI-IGH NeoPolyp, C3VD, sinus endoscopy, UnityCam; others are named by
`--layout kvasir_seg=/data/my/polyps`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.sim_to_real.cells import Cell, RowFile, ordered_cells
from benchmarks.sim_to_real.initialize import is_possible, lacks
from benchmarks.sim_to_real.options import check_amounts, check_tasks, experiment_parser
from benchmarks.sim_to_real.page import PAGE, report
from benchmarks.sim_to_real.real import found_layouts
from benchmarks.sim_to_real.run import DEPTH_ARMS, ONE_NETWORK, complete_cells
from benchmarks.sim_to_real.setup import Setup
from benchmarks.sim_to_real.tasks import DEPTH, DEPTH_TASK, FRACTIONS, TASKS, Task
from vrcaps.core.errors import InputError, VrcapsError


def parsed() -> argparse.Namespace:
    """Options of the command line."""
    parser = experiment_parser(__doc__ or "", PAGE)
    add = parser.add_argument
    add("--ours", action="append", default=[], help="folder or URL of a data set; repeat for more")
    words = "folder of weights learned on ours: TASK-scratch.safetensors, TASK-imagenet.safetensors"
    add("--weights", type=Path, help=f"{words}; depth.safetensors is judged as it is")
    add("--fractions", nargs="*", type=float, default=FRACTIONS, help="of the real images")
    return parser.parse_args()


def main() -> None:
    """Run the missing cells, then write the page."""
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
        InputError: If there is no data for a requested task.
    """
    setup = Setup(
        found_layouts(given.real, given.layout),
        given.run,
        tuple(given.ours),
        given.weights,
        given.preset,
        given.device,
    )
    complete_cells(setup, main_cells(given, setup), rows, given.workers)


def main_cells(given: argparse.Namespace, setup: Setup) -> list[Cell]:
    """Cells of the tasks with data."""
    check_tasks(given.tasks)
    check_amounts(given.fractions, given.seeds)
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
    """Arms of a task with images; reports missing images of the simulated data set."""
    arms = [arm for arm in task.arms if is_possible(setup, task, arm)]
    reason = lacks(setup, task) if "ours" in arms else ""
    if reason:
        print(f"{task.name} goes without ours: {reason}")
    return [arm for arm in arms if not (reason and arm.endswith("ours"))]


if __name__ == "__main__":
    main()
