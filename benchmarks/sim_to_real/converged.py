"""Claim: pre-training on simulated images helps converged networks on images of another hospital.

Trains networks that segment polyps on fractions of Kvasir-SEG until the validation metric no longer
improves, from ImageNet weights and from weights pre-trained on simulated images, and evaluates them
on other images of Kvasir-SEG and on those of BKAI-IGH NeoPolyp, which no training uses. Networks
with pre-training are evaluated twice: as trained, and averaged with the pre-trained weights.

    python -m benchmarks.sim_to_real.converged --real /data/endoscopy --run runs/converged
    python -m benchmarks.sim_to_real.converged --run runs/converged --report   # the page only

Each network is one row of `rows.jsonl`; the same command resumes after an interruption.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import ROOT, table
from benchmarks.sim_to_real.cells import Cell, Row, RowFile, complete, digest_of
from benchmarks.sim_to_real.images import FOLDS, Pictures
from benchmarks.sim_to_real.options import check_amounts
from benchmarks.sim_to_real.page import ARM_TITLES, PAGE, shown_interval, write_part
from benchmarks.sim_to_real.real import found_layouts, read_masks
from benchmarks.sim_to_real.setup import frames_of
from benchmarks.sim_to_real.statistics import (
    Judged,
    difference_interval,
    figure_interval,
    same_images_interval,
)
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.core.files import file_sha256
from vrcaps.learn.baselines import mask_baselines
from vrcaps.learn.checkpoint import TrainedNetwork, read_weights
from vrcaps.learn.evaluation import evaluate
from vrcaps.learn.initialize import initialized_network, mean_with_start
from vrcaps.learn.networks import Backbone
from vrcaps.learn.samples import Samples
from vrcaps.learn.settings import IMAGENET, TrainSettings
from vrcaps.learn.task import Sample
from vrcaps.learn.tasks.segmentation import SegmentationTask
from vrcaps.learn.training import BEST, train
from vrcaps.metrics.bootstrap import Interval
from vrcaps.metrics.labels import dice
from vrcaps.training import ComputeSettings, exact_torch

MODULE = "benchmarks.sim_to_real.converged"
COMMAND = f"python -m {MODULE} --run runs/converged --report"
TASK, KIND, HOME, OTHER = "polyp-masks-converged", "polyp", "kvasir_seg", "bkai"
OURS, AVERAGED = "imagenet+ours", "imagenet+ours+averaged"
SHARE = 0.85
"""Fraction of the trained parameters in their mean with those of the pre-training."""
WEIGHTS = ROOT / "weights/segmentation-polyp.safetensors"
DISC = "disc"
"""Baseline: the centered disc with the highest metric on the evaluated images."""
FRACTIONS = (0.1, 1.0, 0.25, 0.05)
"""Fractions of the real training images, the most informative first."""
EVALUATIONS = 6
"""Number of evaluations on the validation fold; the best checkpoint is tested."""
RATE, BATCH = 1e-3, 8
"""Maximum learning rate and batch size, as in the other experiments."""
AVERAGED_VALUES = "averaged_home", "averaged_other"
"""Names of the results of averaged networks in the rows of `OURS`."""
NEARLY = 0.95
"""Fraction of the best validation metric that measures the speed of convergence."""

Arms = Mapping[tuple[str, float], Mapping[int, Row]]
"""Rows by seed, of each arm and fraction."""


@dataclass(frozen=True)
class Experiment:
    """Images, initialization and length of all trainings.

    Attributes:
        home: Images of the source of the training images.
        other: Images of the other source, only for evaluation.
        weights: Weights pre-trained on simulated images.
        size: Side of the images [px].
        steps: Maximum number of training steps.
    """

    home: Pictures
    other: Pictures
    weights: Path
    size: int
    steps: int

    @property
    def task(self) -> SegmentationTask:
        """Settings of the networks."""
        return SegmentationTask(classes=(KIND,), backbone=Backbone(self.size))

    @property
    def every(self) -> int:
        """Number of steps between evaluations."""
        return -(-self.steps // EVALUATIONS)

    def made_of(self, cell: Cell) -> dict[str, str]:
        """Names of the inputs of a cell's result, besides the cell itself."""
        settings = [self.size, self.steps, EVALUATIONS, RATE, BATCH]
        first = f"{file_sha256(self.weights)[:12]}-{SHARE:g}" if cell.arm == OURS else ""
        return {"basis": digest_of([settings, self.home.digest, self.other.digest]), "first": first}

    def parts(self, seed: int) -> tuple[Pictures, Pictures, Pictures]:
        """Training, validation and test images of the training source: three, one, one fold."""
        rest, held = self.home.split(seed % FOLDS)
        return *rest.split((seed + 1) % FOLDS), held

    def samples(self, pictures: Pictures) -> Samples:
        """Images as samples of the task."""
        return Samples(self.task, frames_of(pictures))


def main() -> None:
    """Train the missing networks, then write the section of the page."""
    made = argparse.ArgumentParser(
        prog=f"python -m {MODULE}",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = made.add_argument
    add("--run", type=Path, required=True, help="folder of the experiment: rows of networks")
    add("--real", type=Path, help="folder with folders of real data")
    add("--layout", action="append", default=[], help=f"NAME=FOLDER, NAME {HOME} or {OTHER}")
    add("--weights", type=Path, default=WEIGHTS, help="pre-trained on ours")
    add("--fractions", nargs="+", type=float, default=FRACTIONS, help="of the real images")
    add("--seeds", type=int, default=5, help="networks of each kind")
    add("--size", type=int, default=96, help="side of the images [px]")
    add("--steps", type=int, default=600, help="maximum number of training steps")
    add("--workers", type=int, default=1, help="processes, each of one thread")
    add("--report", action="store_true", help="only write the page")
    add("--out", type=Path, default=PAGE, help="Markdown page to write into")
    given = made.parse_args()
    try:
        rows = RowFile(given.run)
        if not given.report:
            check_amounts(given.fractions, given.seeds)
            experiment = experiment_of(given)
            cells = cells_of(given.fractions, given.seeds)
            complete(cells, rows, experiment.made_of, made_by(experiment, given.workers))
        write_part(given.out, MODULE, page_text(list(rows.rows.values())), COMMAND)
    except VrcapsError as error:
        sys.exit(str(error))


def experiment_of(given: argparse.Namespace) -> Experiment:
    """Read the images of both sources.

    Raises:
        InputError: If a source is missing.
    """
    real = found_layouts(given.real, given.layout)
    if missing := [name for name in (HOME, OTHER) if name not in real]:
        raise InputError(f"There is no data set {' and '.join(missing)}. Give --real or --layout.")
    home, other = (read_masks(real[name], given.size, KIND) for name in (HOME, OTHER))
    return Experiment(home, other, given.weights, given.size, given.steps)


def cells_of(fractions: Sequence[float], seeds: int) -> list[Cell]:
    """All cells, seed by seed; those without training first."""
    without = [Cell(TASK, arm, 0.0, seed) for seed in range(seeds) for arm in (DISC, OURS)]
    return without + [
        Cell(TASK, arm, fraction, seed)
        for seed in range(seeds)
        for fraction in fractions
        for arm in (IMAGENET, OURS)
    ]


def made_by(experiment: Experiment, workers: int) -> Callable[[Sequence[Cell]], Iterator[Row]]:
    """Function that makes rows of cells, in one or several processes."""

    def made(cells: Sequence[Cell]) -> Iterator[Row]:
        if workers < 2:
            yield from (run_cell(experiment, cell) for cell in cells)
            return
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for done in as_completed([pool.submit(run_cell, experiment, one) for one in cells]):
                yield done.result()

    return made


def run_cell(experiment: Experiment, cell: Cell) -> Row:
    """Train one network and evaluate it on held-out images of both sources."""
    began = time.perf_counter()
    training, validation, held = experiment.parts(cell.seed)
    tested = [experiment.samples(part) for part in (held, experiment.other)]
    values: dict[str, list[float]] = {
        "other_groups": experiment.other.groups.tolist(),
        "curve": [],
        "every": [float(experiment.every)],
    }
    with exact_torch(1):
        if cell.arm == DISC:
            values["home"], values["other"] = (disc_dice(one) for one in tested)
        else:
            trained = untrained(experiment)
            if cell.fraction > 0.0:
                trained, values["curve"] = trained_of(experiment, cell, training, validation)
            values["home"], values["other"] = (network_dice(trained, one) for one in tested)
            if cell.fraction > 0.0 and cell.arm == OURS:
                mean = averaged(experiment, trained)
                names = AVERAGED_VALUES
                values |= {n: network_dice(mean, one) for n, one in zip(names, tested, strict=True)}
    seconds = round(time.perf_counter() - began, 1)
    return Row(cell, experiment.made_of(cell), values, held.groups.tolist(), seconds)


def untrained(experiment: Experiment) -> TrainedNetwork:
    """Network with the weights pre-trained on simulated images, without real ones."""
    network = initialized_network(experiment.task, str(experiment.weights))
    return TrainedNetwork(experiment.task, network.eval(), {}, "cpu")


def trained_of(
    experiment: Experiment, cell: Cell, training: Pictures, validation: Pictures
) -> tuple[TrainedNetwork, list[float]]:
    """Network with the best validation metric, and that metric at each evaluation."""
    settings = TrainSettings(
        experiment.task,
        start=str(experiment.weights) if cell.arm == OURS else IMAGENET,
        steps=experiment.steps,
        batch=BATCH,
        learning_rate=RATE,
        fraction=cell.fraction,
        evaluate_every=experiment.every,
        evaluation_frames=len(validation),
        seed=cell.seed,
    )
    samples = [experiment.samples(part) for part in (training, validation)]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "cell"
        progress = train(settings, *samples, out, compute=ComputeSettings("cpu"))
        trained = read_weights(out / BEST, device="cpu")
    name = experiment.task.metric.name
    return trained, [round(float(row[name]), 5) for row in progress.rows]


def averaged(experiment: Experiment, trained: TrainedNetwork) -> TrainedNetwork:
    """Network with the mean of the trained parameters and those of the pre-training."""
    start = untrained(experiment).network.state_dict()
    return replace(trained, network=mean_with_start(trained.network, start, SHARE))


def network_dice(trained: TrainedNetwork, samples: Samples) -> list[float]:
    """Dice coefficient of each image."""
    found = evaluate(trained, samples)
    return dice_of([output[0] > 0.0 for output in found.outputs], found.samples)


def disc_dice(samples: Samples) -> list[float]:
    """Dice coefficient of each image for the centered disc that is best for all of them."""
    known = [samples.next(index) for index in range(len(samples))]
    masks = [sample["mask"][..., 0] == 1 for sample in known]
    return dice_of(mask_baselines([s["image"] for s in known], masks)["centered disc"], known)


def dice_of(masks: Sequence[np.ndarray], samples: Sequence[Sample]) -> list[float]:
    """Dice coefficient of each mask, without the padding of the image."""
    known = [sample["mask"][..., 0] for sample in samples]
    scores = [
        dice(mask & (truth < 2), truth == 1) for mask, truth in zip(masks, known, strict=True)
    ]
    return np.round(scores, 5).tolist()


def page_text(rows: Sequence[Row]) -> str:
    """Section of the page: metrics, differences, and speed of convergence.

    Raises:
        InputError: If there are no rows.
    """
    arms = arms_of(rows)
    if not arms:
        raise InputError("There are no networks yet. Give --real to train them.")
    fractions = sorted({fraction for _, fraction in arms if fraction > 0.0})
    known = [row for (arm, _), rows in arms.items() if arm != AVERAGED for row in rows.values()]
    hours = sum(row.seconds for row in known) / 3600.0
    body = [
        [f"{100.0 * fraction:g} %", ARM_TITLES[arm], *cells_text(arms, arm, fraction)]
        for fraction in fractions
        for arm in (IMAGENET, OURS, AVERAGED)
        if (arm, fraction) in arms
    ]
    body = [
        *(
            ["0 %", title, *cells_text(arms, arm, 0.0)]
            for arm, title in ((DISC, "centered disc"), (OURS, ARM_TITLES[OURS]))
            if (arm, 0.0) in arms
        ),
        *body,
    ]
    head = ["real images", "", "Kvasir-SEG", "BKAI-IGH NeoPolyp", "steps to 95 %", "networks"]
    gains = [
        [f"{100.0 * fraction:g} %", ARM_TITLES[arm], *difference_text(arms, arm, fraction)]
        for fraction in fractions
        for arm in (OURS, AVERAGED)
        if (arm, fraction) in arms
    ]
    gain_head = ["real images", "", "Kvasir-SEG", "BKAI-IGH NeoPolyp", "seeds"]
    parts = [
        "## Converged networks in the same and another hospital: results",
        f"{len(known)} networks and baselines, {hours:.1f} hours. Dice; in brackets 95 % intervals "
        "over seeds and groups of images.",
        table(head, body),
        "Minus *ImageNet*, in points of Dice:",
        table(gain_head, gains),
    ]
    return "\n\n".join(parts)


def arms_of(rows: Sequence[Row]) -> Arms:
    """Rows of each arm and fraction by seed, of the newest settings, data and weights."""
    basis = rows[-1].made_of["basis"] if rows else ""
    kept = [row for row in rows if row.made_of["basis"] == basis]
    first = {row.cell.arm: row.made_of["first"] for row in kept}
    found: dict[tuple[str, float], dict[int, Row]] = {}
    known = [row for row in kept if row.made_of["first"] == first[row.cell.arm]]
    for row in [*known, *averaged_rows(known)]:
        found.setdefault((row.cell.arm, row.cell.fraction), {})[row.cell.seed] = row
    return {key: dict(sorted(by_seed.items())) for key, by_seed in found.items()}


def averaged_rows(rows: Sequence[Row]) -> list[Row]:
    """Separate rows with the results of averaged networks."""
    return [
        replace(
            row,
            cell=replace(row.cell, arm=AVERAGED),
            values=row.values
            | dict(zip(("home", "other"), (row.values[n] for n in AVERAGED_VALUES), strict=True)),
        )
        for row in rows
        if AVERAGED_VALUES[0] in row.values
    ]


def cells_text(arms: Arms, arm: str, fraction: float) -> list[str]:
    """Metrics in both sources, steps of convergence, and number of networks."""
    rows = [*arms[arm, fraction].values()]
    shown = [shown_interval(one, 100.0, 1) for one in (home_interval(rows), other_interval(rows))]
    steps = [convergence(row) for row in rows if row.values["curve"]]
    median = f"{np.median(steps):.0f}" if steps else ""
    return [*shown, median, str(len(rows)) if arm != DISC else ""]


def difference_text(arms: Arms, arm: str, fraction: float) -> list[str]:
    """Differences of an arm from ImageNet in both sources, over common seeds."""
    first, second = (arms.get((one, fraction), {}) for one in (arm, IMAGENET))
    seeds = sorted({*first} & {*second})
    if not seeds:
        return ["", "", "0"]
    pairs = [first[seed] for seed in seeds], [second[seed] for seed in seeds]
    home = difference_interval(_mean, *([home_judged(row) for row in rows] for rows in pairs))
    other = other_interval(*pairs)
    return [*(shown_interval(one, 100.0, 1, "+") for one in (home, other)), str(len(seeds))]


def home_judged(row: Row) -> Judged:
    """Result on the test fold of the training source."""
    values = np.array(row.values["home"])
    return Judged(np.column_stack([values, np.ones_like(values)]), np.array(row.groups))


def home_interval(rows: Sequence[Row]) -> Interval:
    """Mean over seeds, each on another fold."""
    return figure_interval(_mean, [home_judged(row) for row in rows])


def other_interval(rows: Sequence[Row], less: Sequence[Row] | None = None) -> Interval:
    """Mean over seeds, all on the same images; minus that of other rows of the same seeds."""
    values = np.array([row.values["other"] for row in rows])
    if less is not None:
        values = values - np.array([row.values["other"] for row in less])
    return same_images_interval(values, np.array(rows[0].values["other_groups"], int))


def convergence(row: Row) -> float:
    """Number of training steps at the first evaluation that is nearly the best."""
    curve = np.array(row.values["curve"])
    return (int(np.argmax(curve >= NEARLY * curve.max())) + 1) * row.values["every"][0]


def _mean(sums: np.ndarray) -> np.ndarray:
    return sums[:, 0] / sums[:, 1]


if __name__ == "__main__":
    main()
