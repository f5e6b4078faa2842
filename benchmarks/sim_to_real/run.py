"""One cell of the experiment: training on real images, evaluation; and all missing cells."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.sim_to_real.cells import LONG, LONG_FACTOR, Cell, Row, RowFile, complete, digest_of
from benchmarks.sim_to_real.depth import (
    by_light,
    by_mean,
    by_network,
    constant,
    depth_values,
    read_c3vd,
    read_sinus,
)
from benchmarks.sim_to_real.general import GENERAL, enlarged, made_by
from benchmarks.sim_to_real.initialize import (
    PUBLISHED,
    STARTS,
    first_folder,
    first_weights,
    given_weights,
)
from benchmarks.sim_to_real.setup import Setup, frames_of, settings_of, task_of
from benchmarks.sim_to_real.simulated import data_digest, our_sequences
from benchmarks.sim_to_real.tasks import DEPTH, DEPTH_TASK, Effort
from vrcaps.config.convert import to_plain
from vrcaps.core.files import file_sha256, files_in
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.evaluation import EvaluationResult, evaluate
from vrcaps.learn.initialize import initialized_network
from vrcaps.learn.model_card import task_values
from vrcaps.learn.samples import Samples
from vrcaps.learn.task import Task as NetworkTask
from vrcaps.learn.training import WEIGHTS, train
from vrcaps.training import exact_torch

WITHOUT_LEARNING = ("constant", "mean", "light")
ONE_NETWORK = (*WITHOUT_LEARNING, PUBLISHED)
DEPTH_ARMS = (*ONE_NETWORK, "ours", "imagenet+ours", "unitycam", "imagenet+unitycam")
_ROW_KINDS = {"segmentation": "masks", "classification": "classes"}
_ROW_NAMES = {
    "exposure_jitter": "brightness",
    "color_jitter": "tint",
    "gamma_jitter": "gamma",
    "min_crop": "zoom",
    "mask_overlays": "hides",
}
"""Names of tasks and settings in the digests of the stored rows."""
DEPTH_READERS = {"c3vd": read_c3vd, "sinus": read_sinus}


def run_cell(setup: Setup, cell: Cell) -> Row:
    """Train and evaluate; only the row and the pre-trained weights are kept.

    Raises:
        InputError: If data that it needs cannot be read.
    """
    began = time.perf_counter()
    with exact_torch(1) if setup.device == "cpu" else nullcontext():
        values, groups = _depth(setup, cell) if cell.task == DEPTH else _transfer(setup, cell)
    seconds = round(time.perf_counter() - began, 1)
    return Row(cell, made_of(setup, cell), values, groups, seconds)


def _transfer(setup: Setup, cell: Cell) -> tuple[dict[str, list[float]], list[int]]:
    """Values of the fold that a seed holds out, and groups of its images."""
    task, pictures = task_of(cell), setup.pictures(task_of(cell))
    learned, held = pictures.split(cell.seed % (pictures.folds.max() + 1))
    learner = task.learner(setup.effort(task))
    judged = Samples(learner, frames_of(held))
    if cell.arm == GENERAL:
        samples = [judged.next(k) for k in range(len(judged))]
        found = EvaluationResult({}, [enlarged(sample["image"]) for sample in samples], samples)
        return task.values(found), held.groups.tolist()
    if cell.fraction == 0.0:
        network = initialized_network(learner, first_weights(setup, cell))
        trained = TrainedNetwork(learner, network.to(setup.device).eval(), {}, setup.device)
        return task.values(evaluate(trained, judged)), held.groups.tolist()
    steps = setup.effort(task).steps * (LONG_FACTOR if cell.arm == LONG else 1)
    settings = settings_of(setup, cell, learner, steps)
    settings = replace(settings, start=first_weights(setup, cell), fraction=cell.fraction)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "cell"
        few = Samples(learner, frames_of(learned)[:8])
        train(settings, Samples(learner, frames_of(learned)), few, out, compute=setup.machine)
        trained = read_weights(out / WEIGHTS, device=setup.device)
    return task.values(evaluate(trained, judged)), held.groups.tolist()


def _depth(setup: Setup, cell: Cell) -> tuple[dict[str, list[float]], list[int]]:
    """Values of the real frames with depth, by their data set; groups are unknown."""
    if cell.arm in WITHOUT_LEARNING:
        size = setup.effort(DEPTH_TASK).size
        estimate = {"constant": constant, "light": by_light}.get(cell.arm)
        estimate = estimate or by_mean(our_sequences(setup.ours_of(cell))[0], size)
    else:
        estimate = by_network(read_weights(first_weights(setup, cell), device=setup.device))
    found: dict[str, list[float]] = {}
    for name, read in DEPTH_READERS.items():
        if name in setup.real:
            values = depth_values(estimate, read(setup.real[name]))
            found |= {f"{name}_{figure}": numbers for figure, numbers in values.items()}
    return found, []


def made_of(setup: Setup, cell: Cell) -> dict[str, str]:
    """Names of the inputs of a cell's result, besides the cell itself.

    Results of one task are compared if `basis` is the same: settings and real images. `first`
    states the pre-training: task, data and duration.
    """
    task = task_of(cell)
    if task.kind == DEPTH:
        real = [folder_digest(setup.real[name]) for name in DEPTH_READERS if name in setup.real]
    else:
        real = [setup.pictures(task).digest]
    effort = setup.effort(task)
    learning = [effort.size, effort.steps, effort.batch, effort.rate]
    basis = [_plain(task.learner(effort)), learning, real]
    given, first = given_weights(setup, cell), ""
    if given is not None:
        first = file_sha256(given)[:12]
    elif cell.arm == GENERAL:
        first = made_by()
    elif cell.arm == "mean":
        first = data_digest(setup.ours_of(cell))
    elif cell.arm.endswith(("ours", "unitycam")):
        is_ours = cell.arm.endswith("ours")
        source = (
            data_digest(setup.ours_of(cell)) if is_ours else folder_digest(setup.real["unitycam"])
        )
        learners = [_plain(one) for one in task.first_learners(effort)]
        first = digest_of([learners, to_plain(effort, Effort), source])
    names = {"preset": setup.preset, "device": setup.device}
    return {"basis": digest_of(basis), "first": first, **names}


def _plain(task: NetworkTask) -> dict[str, Any]:
    """Settings of a network's task, in the form whose digests the stored rows contain."""
    values = {_ROW_NAMES.get(name, name): value for name, value in task_values(task).items()}
    if task.kind in _ROW_KINDS:
        del values["gamma"]
    return {"kind": _ROW_KINDS.get(task.kind, task.kind), **values}


@cache
def folder_digest(folder: Path) -> str:
    """Digest of the names and sizes of the files of a folder, of twelve digits."""
    files = [(str(path.relative_to(folder)), path.stat().st_size) for path in files_in(folder)]
    return digest_of(files)


def _first_name(setup: Setup, cell: Cell) -> str:
    """Pre-training of a cell's network, by the folder of its weights."""
    if (given := given_weights(setup, cell)) is not None:
        return str(given)
    task = task_of(cell)
    return str(first_folder(setup, cell, task.first_learners(setup.effort(task))[-1]))


def complete_cells(setup: Setup, cells: Sequence[Cell], rows: RowFile, workers: int) -> None:
    """Run the cells that have no row yet, and report the progress."""
    complete(cells, rows, partial(made_of, setup), partial(made_rows, setup, workers))


def made_rows(setup: Setup, workers: int, cells: Sequence[Cell]) -> Iterator[Row]:
    """Rows of cells in the order of completion, made in one or several processes."""
    if workers < 2:
        yield from (run_cell(setup, cell) for cell in cells)
        return
    # Weights to begin with come first, so that no two processes learn the same.
    alone = (*STARTS, *WITHOUT_LEARNING, GENERAL)
    learning = [cell for cell in cells if cell.arm not in alone]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        wanted = {_first_name(setup, cell): cell for cell in learning}
        list(pool.map(first_weights, [setup] * len(wanted), wanted.values()))
        for done in as_completed([pool.submit(run_cell, setup, cell) for cell in cells]):
            yield done.result()
