"""One cell of the experiment: weights to begin with, training on real images, judging."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from transfer_cells import Cell, Row, RowFile, digest_of
from transfer_depth import (
    by_light,
    by_mean,
    by_network,
    constant,
    depth_values,
    read_c3vd,
    read_sinus,
)
from transfer_general import GENERAL, enlarged, is_installed, made_by
from transfer_ours import Urls, data_digest, evenly, our_classes, our_masks, our_sequences
from transfer_pictures import Pictures
from transfer_real import middle
from transfer_tasks import DEPTH, DEPTH_TASK, PRESETS, Effort, Task, task_named
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.errors import InputError
from vrcaps.files import file_sha256, files_in
from vrcaps.formats.read_format import read_format
from vrcaps.learn.first_network import IMAGENET, SCRATCH
from vrcaps.learn.samples import Samples, samples_of
from vrcaps.learn.training import (
    CHECKPOINT,
    WEIGHTS,
    Machine,
    TrainSettings,
    train,
)
from vrcaps.learn.validation import Found, validate
from vrcaps.learn.weights import read_weights
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.serialization import to_plain
from vrcaps.tools.reconstruction.estimates import with_depth
from vrcaps.torch_threads import exact_torch

WITHOUT_LEARNING = ("constant", "mean", "light")
PUBLISHED = "published"
"""Weights of vrcaps as they are: `depth.safetensors` of the folder of weights."""
ONE_NETWORK = (*WITHOUT_LEARNING, PUBLISHED)
DEPTH_ARMS = (*ONE_NETWORK, "ours", "imagenet+ours", "unitycam", "imagenet+unitycam")
DEPTH_READERS = {"c3vd": read_c3vd, "sinus": read_sinus}
_MOST_LARGE, _MOST_DEPTH = 400, 2000
"""Most of our frames that super-resolution and depth learn from, evenly spread."""
_UNITYCAM = (156.0418, 155.7529, 178.5604, 181.8043, 360.0)
"""fx, fy, cx, cy and width [px] of UnityCam's `cam.txt`, for frames that have none beside them."""


@dataclass(frozen=True)
class Setup:
    """What an experiment is made of.

    Attributes:
        real: Folders of real data by layout.
        out: Folder of its files.
        ours: Folders or URLs of our data sets; without any, arms that need them are left out.
        weights: Folder of weights that were learned on ours; None learns them here.
        preset: Name of the preset.
        device: Where networks learn.
        variants: Our data sets that lack something, by what they lack.
    """

    real: Mapping[str, Path]
    out: Path
    ours: Urls = ()
    weights: Path | None = None
    preset: str = "quick"
    device: str = "cpu"
    variants: Mapping[str, str] | None = None

    def effort(self, task: Task) -> Effort:
        """Effort of a task."""
        return PRESETS[self.preset][task.kind]

    def pictures(self, task: Task) -> Pictures:
        """Real images of a task."""
        return task.read(self.real[task.layout], self.effort(task))

    def ours_of(self, cell: Cell) -> Urls:
        """Our data sets that a cell's weights were learned on.

        Raises:
            InputError: If none was given.
        """
        urls = ((self.variants or {})[cell.variant],) if cell.variant else self.ours
        if not urls:
            raise InputError("There are no images of ours. Give --ours URL.")
        return urls


def task_of(cell: Cell) -> Task:
    """The task of a cell."""
    return task_named(cell.task)


def made_of(setup: Setup, cell: Cell) -> dict[str, str]:
    """Names of what a cell's result follows from, beside the cell itself.

    Results of one task are compared where `basis` is the same: settings, and real images. `first`
    is what was learned from before.
    """
    task = task_of(cell)
    if task.kind == DEPTH:
        real = [folder_digest(setup.real[name]) for name in DEPTH_READERS if name in setup.real]
    else:
        real = [setup.pictures(task).digest]
    learner = to_plain(_settings(setup, cell, 1), TrainSettings)["learner"]
    basis = [learner, to_plain(setup.effort(task), Effort), real]
    given = given_weights(setup, cell)
    first = ""
    if given is not None:
        first = file_sha256(given)[:12]
    elif cell.arm.endswith("ours") or cell.arm == "mean":
        first = data_digest(setup.ours_of(cell))
    elif cell.arm == GENERAL:
        first = made_by()
    elif cell.arm.endswith("unitycam"):
        first = folder_digest(setup.real["unitycam"])
    names = {"preset": setup.preset, "device": setup.device}
    return {"basis": digest_of(basis), "first": first, **names}


@cache
def folder_digest(folder: Path) -> str:
    """Twelve digits that name the files of a folder, by names and sizes."""
    files = [(str(path.relative_to(folder)), path.stat().st_size) for path in files_in(folder)]
    return digest_of(files)


def _settings(setup: Setup, cell: Cell, steps: int) -> TrainSettings:
    """Settings that all trainings of a task have in common."""
    task = task_of(cell)
    effort = setup.effort(task)
    return TrainSettings(
        task.learner(effort),
        start=SCRATCH,
        steps=steps,
        batch=effort.batch,
        rate=effort.rate,
        evaluate_every=steps,
        evaluation_frames=8,
        seed=cell.seed,
    )


def run_cell(setup: Setup, cell: Cell) -> Row:
    """Train and judge; nothing of it stays but the row and the weights learned on ours.

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
    judged = Samples(learner, _frames(held))
    if cell.arm == GENERAL:
        samples = [judged.next(k) for k in range(len(judged))]
        found = Found({}, [enlarged(sample["image"]) for sample in samples], samples)
        return task.values(found), held.groups.tolist()
    start = first_weights(setup, cell)
    if cell.fraction == 0.0:
        trained = read_weights(start, task=task.kind, device=setup.device)
        return task.values(validate(trained, judged)), held.groups.tolist()
    settings = _settings(setup, cell, setup.effort(task).steps)
    settings = replace(settings, start=start, fraction=cell.fraction)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "cell"
        few = Samples(learner, _frames(learned)[:8])
        train(settings, Samples(learner, _frames(learned)), few, out, machine=_machine(setup))
        trained = read_weights(out / WEIGHTS, device=setup.device)
    return task.values(validate(trained, judged)), held.groups.tolist()


def _depth(setup: Setup, cell: Cell) -> tuple[dict[str, list[float]], list[int]]:
    """Values of the real frames with depth, by their data set; groups are not known."""
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


def first_weights(setup: Setup, cell: Cell) -> str:
    """What training of a cell begins with: `scratch`, `imagenet`, or a file of weights.

    Weights that were learned on other images are made once, and kept.

    Raises:
        InputError: If there is nothing to learn from.
    """
    if cell.arm in (SCRATCH, IMAGENET):
        return cell.arm
    given = given_weights(setup, cell)
    if given is not None:
        return str(given)
    task = task_of(cell)
    effort = setup.effort(task)
    is_ours = cell.arm.endswith("ours")
    digest = data_digest(setup.ours_of(cell)) if is_ours else "frames"
    seed = _first_seed(cell)
    settings = replace(
        _settings(setup, cell, effort.first_steps),
        start=_first_start(cell),
        seed=seed,
        data=(digest,),
        evaluate_every=-(-effort.first_steps // 4),
        evaluation_frames=100,
    )
    name = f"{task.name}-{cell.arm}-{seed}-{effort.size}px-{effort.first_steps}-{digest}"
    out = setup.out / "weights" / name.replace("+", "-")
    if not (out / WEIGHTS).is_file():
        samples, validation = _first_samples(setup, cell, settings)
        out.parent.mkdir(parents=True, exist_ok=True)
        train(settings, samples, validation, out, machine=_machine(setup), is_forced=True)
        (out / CHECKPOINT).unlink(missing_ok=True)
    return str(out / WEIGHTS)


def _first_seed(cell: Cell) -> int:
    """Seed of what is learned before: one for all of a task, but for depth and ablations."""
    return cell.seed if cell.task == DEPTH or cell.variant else 0


def _first_start(cell: Cell) -> str:
    return IMAGENET if cell.arm.startswith(f"{IMAGENET}+") else SCRATCH


def given_weights(setup: Setup, cell: Cell) -> Path | None:
    """File of weights that were learned on ours elsewhere, if there is one."""
    if setup.weights is None or cell.variant:
        return None
    task = task_of(cell)
    names: tuple[str, ...] = ()
    if cell.arm == PUBLISHED:
        names = (f"{task.kind}.safetensors",)
    elif cell.arm.endswith("ours"):
        names = tuple(f"{one}-{_first_start(cell)}.safetensors" for one in (task.name, task.kind))
    return next((path for name in names if (path := setup.weights / name).is_file()), None)


def is_possible(setup: Setup, task: Task, arm: str) -> bool:
    """Whether there are images or weights for an arm."""
    if arm == GENERAL:
        return is_installed()
    if arm.endswith("unitycam"):
        return "unitycam" in setup.real
    is_given = given_weights(setup, Cell(task.name, arm, 0.0, 0)) is not None
    if arm == PUBLISHED:
        return is_given
    return is_given or bool(setup.ours) or not (arm.endswith("ours") or arm == "mean")


def lacks(setup: Setup, task: Task) -> str:
    """Why our data set cannot serve a task; empty if it can."""
    cell = Cell(task.name, "ours", 0.0, 0)
    if task.kind not in ("classes", "masks"):
        return ""
    try:
        if given_weights(setup, cell) is None:
            _first_samples(setup, cell, _settings(setup, cell, 1))
    except InputError as error:
        return str(error)
    return ""


def _first_samples(setup: Setup, cell: Cell, settings: TrainSettings) -> tuple[Samples, Samples]:
    """Images that are not real, to learn from and to validate with."""
    task, learner = task_of(cell), settings.learner
    if cell.arm.endswith("unitycam"):
        sequences = unitycam(setup.real["unitycam"])
        if task.kind != DEPTH:
            sequences = [_large(evenly(sequences, _MOST_LARGE), 4 * learner.size).sequence()]
        samples = samples_of(learner, sequences)
        return samples, samples
    urls = setup.ours_of(cell)
    if task.kind == "classes":
        parts = our_classes(urls, task.kinds, learner.size, has_overlays=task.has_overlays)
    elif task.kind == "masks":
        parts = our_masks(urls, task.kinds, learner.size)
    else:
        many = _MOST_DEPTH if task.kind == DEPTH else _MOST_LARGE
        chosen = [
            evenly(part, most) for part, most in zip(our_sequences(urls), (many, 100), strict=True)
        ]
        if task.kind == DEPTH:
            return Samples(learner, chosen[0]), Samples(learner, chosen[1] or chosen[0])
        parts = [_large(part or chosen[0], 4 * learner.size) for part in chosen]
    train_part, validation = (samples_of(learner, [part.sequence()]) for part in parts)
    return train_part, validation


def unitycam(folder: Path) -> list[FrameSequence]:
    """Frames of VR-Caps, as published with EndoSLAM, with depth up to scale.

    Their depth images are bright where the wall is near, in steps that grow with distance, as the
    reversed depth buffer of Unity is, which falls with 1 / z. So depth is the inverse of what is
    stored; a value of eight steps, the median, is taken as 30 mm.
    """
    return [_with_camera(_inverted(one)) for one in read_format("endoslam", folder)]


def _inverted(sequence: FrameSequence) -> FrameSequence:
    def depth_of(index: int) -> np.ndarray:
        stored = sequence.image("depth", index)
        return np.where(stored > 0.0, 0.03 * 0.08 / np.maximum(stored, 1e-6), np.nan)

    return with_depth(sequence, depth_of)


def _with_camera(sequence: FrameSequence) -> FrameSequence:
    if sequence.camera is not None:
        return sequence
    height, width = sequence.image("rgb", 0).shape[:2]
    fx, fy, cx, cy = (width / _UNITYCAM[4] * value for value in _UNITYCAM[:4])
    lens = LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy)
    return replace(sequence, camera=Camera("unitycam", lens, width, height))


def _large(frames: Sequence[tuple[FrameSequence, int]], side: int) -> Pictures:
    return Pictures("large", [middle(one.image("rgb", index), side) for one, index in frames])


def _frames(pictures: Pictures) -> list[tuple[FrameSequence, int]]:
    sequence = pictures.sequence()
    return [(sequence, index) for index in range(len(sequence))]


def _machine(setup: Setup) -> Machine:
    return Machine(setup.device)


def complete(setup: Setup, cells: Sequence[Cell], rows: RowFile, workers: int) -> None:
    """Run the cells that have no row yet, and say how it goes."""
    missing = [cell for cell in cells if not rows.has(cell, made_of(setup, cell))]
    print(f"{len(cells)} networks, {len(cells) - len(missing)} of them known.", flush=True)
    began = time.monotonic()
    for done, row in enumerate(made_rows(setup, missing, workers), 1):
        rows.add(row)
        left = (time.monotonic() - began) / done * (len(missing) - done) / 60.0
        note = f"{row.cell}: {row.seconds:.0f} s, {left:.0f} min left"
        print(f"{done}/{len(missing)} {note}", flush=True)


def made_rows(setup: Setup, cells: Sequence[Cell], workers: int) -> Iterator[Row]:
    """Rows of cells as they come: made in this process, or in several."""
    if workers < 2:
        yield from (run_cell(setup, cell) for cell in cells)
        return
    # Weights to begin with come first, so that no two processes learn the same.
    firsts = {(c.task, c.arm, c.variant, _first_seed(c)): c for c in cells}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        given = (*WITHOUT_LEARNING, GENERAL)
        wanted = [cell for cell in firsts.values() if cell.arm not in given]
        list(pool.map(first_weights, [setup] * len(wanted), wanted))
        for done in as_completed([pool.submit(run_cell, setup, cell) for cell in cells]):
            yield done.result()
