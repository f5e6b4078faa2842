"""Initial weights for training on real images: pre-trained on simulated images or on UnityCam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.sim_to_real.cells import LONG, Cell, digest_of
from benchmarks.sim_to_real.general import GENERAL, is_installed
from benchmarks.sim_to_real.images import Pictures
from benchmarks.sim_to_real.real import middle
from benchmarks.sim_to_real.setup import Setup, settings_of, task_of
from benchmarks.sim_to_real.simulated import (
    data_digest,
    evenly,
    our_classes,
    our_masks,
    our_sequences,
)
from benchmarks.sim_to_real.tasks import DEPTH, Effort, Task
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.config.convert import to_plain
from vrcaps.core.errors import InputError
from vrcaps.formats.io import read_format
from vrcaps.learn.registry import FORMER_TASKS
from vrcaps.learn.samples import Samples, samples_of
from vrcaps.learn.settings import IMAGENET, SCRATCH
from vrcaps.learn.task import Task as NetworkTask
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.learn.tasks.segmentation import SegmentationTask
from vrcaps.learn.training import CHECKPOINT, WEIGHTS, train
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.estimates import with_depth

STARTS = {SCRATCH: SCRATCH, IMAGENET: IMAGENET, LONG: IMAGENET}
"""Initialization of arms without pre-training on other images."""
PUBLISHED = "published"
"""Weights of vrcaps as they are: `depth.safetensors` of the folder of weights."""
_MAX_LARGE, _MAX_DEPTH = 400, 2000
"""Most of our frames that super-resolution and depth learn from, evenly spread."""
_UNITYCAM = (156.0418, 155.7529, 178.5604, 181.8043, 360.0)
"""fx, fy, cx, cy and width [px] of UnityCam's `cam.txt`, for frames that have none beside them."""


def first_weights(setup: Setup, cell: Cell) -> str:
    """Initialization of the training of a cell: `scratch`, `imagenet`, or a file of weights.

    Weights that were learned on other images are made once, and kept.

    Raises:
        InputError: If there is nothing to learn from.
    """
    if cell.arm in STARTS:
        return STARTS[cell.arm]
    given = given_weights(setup, cell)
    if given is not None:
        return str(given)
    start = _first_start(cell)
    for learner in task_of(cell).first_learners(setup.effort(task_of(cell))):
        start = _learned(setup, cell, learner, start)
    return start


def first_folder(setup: Setup, cell: Cell, learner: NetworkTask) -> Path:
    """Folder of the pre-trained weights; tasks with equal pre-training share it."""
    effort = setup.effort(task_of(cell))
    digest = data_digest(setup.ours_of(cell)) if cell.arm.endswith("ours") else "frames"
    what = digest_of([to_plain(learner, type(learner)), to_plain(effort, Effort), digest])
    name = f"{learner.kind}-{cell.arm}-{first_seed(cell)}-{effort.size}px-{what}"
    return setup.out / "weights" / name.replace("+", "-")


def _learned(setup: Setup, cell: Cell, learner: NetworkTask, start: str) -> str:
    """File of weights pre-trained on simulated images."""
    effort, out = setup.effort(task_of(cell)), first_folder(setup, cell, learner)
    settings = replace(
        settings_of(setup, cell, learner, effort.first_steps),
        start=start,
        seed=first_seed(cell),
        data=(out.name,),
        evaluate_every=-(-effort.first_steps // 4),
        evaluation_frames=100,
    )
    if not (out / WEIGHTS).is_file():
        samples, validation = _first_samples(setup, cell, learner)
        out.parent.mkdir(parents=True, exist_ok=True)
        train(settings, samples, validation, out, compute=setup.machine, is_forced=True)
        (out / CHECKPOINT).unlink(missing_ok=True)
    return str(out / WEIGHTS)


def first_seed(cell: Cell) -> int:
    """Seed of pre-training: one for all cells of a task, except for depth and ablations."""
    return cell.seed if cell.task == DEPTH or cell.variant else 0


def _first_start(cell: Cell) -> str:
    return IMAGENET if cell.arm.startswith(f"{IMAGENET}+") else SCRATCH


def given_weights(setup: Setup, cell: Cell) -> Path | None:
    """File of weights pre-trained elsewhere on simulated images, if there is one."""
    if setup.weights is None or cell.variant:
        return None
    task = task_of(cell)
    names: tuple[str, ...] = ()
    if cell.arm == PUBLISHED:
        names = (f"{FORMER_TASKS.get(task.kind, task.kind)}.safetensors",)
    elif cell.arm.endswith("ours"):
        names = tuple(f"{one}-{_first_start(cell)}.safetensors" for one in (task.name, task.kind))
    return next((path for name in names if (path := setup.weights / name).is_file()), None)


def is_possible(setup: Setup, task: Task, arm: str) -> bool:
    """Return whether there are images or weights for an arm."""
    if arm == GENERAL:
        return is_installed()
    if arm.endswith("unitycam"):
        return "unitycam" in setup.real
    is_given = given_weights(setup, Cell(task.name, arm, 0.0, 0)) is not None
    if arm == PUBLISHED:
        return is_given
    return is_given or bool(setup.ours) or not (arm.endswith("ours") or arm == "mean")


def lacks(setup: Setup, task: Task) -> str:
    """Reason why the simulated data set is unsuitable for a task; empty if it is suitable."""
    cell = Cell(task.name, "ours", 0.0, 0)
    if task.kind not in ("classes", "masks"):
        return ""
    try:
        if given_weights(setup, cell) is None:
            for learner in task.first_learners(setup.effort(task)):
                _first_samples(setup, cell, learner)
    except InputError as error:
        return str(error)
    return ""


def _first_samples(setup: Setup, cell: Cell, learner: NetworkTask) -> tuple[Samples, Samples]:
    """Simulated training and validation images."""
    task = task_of(cell)
    if cell.arm.endswith("unitycam"):
        sequences = unitycam(setup.real["unitycam"])
        if task.kind != DEPTH:
            sequences = [_large(evenly(sequences, _MAX_LARGE), 4 * learner.input_size).sequence()]
        samples = samples_of(learner, sequences)
        return samples, samples
    urls = setup.ours_of(cell)
    if isinstance(learner, ClassificationTask):
        parts = our_classes(urls, learner.classes, learner.input_size)
    elif isinstance(learner, SegmentationTask):
        parts = our_masks(urls, learner.classes, learner.input_size)
    else:
        many = _MAX_DEPTH if task.kind == DEPTH else _MAX_LARGE
        chosen = [
            evenly(part, most) for part, most in zip(our_sequences(urls), (many, 100), strict=True)
        ]
        if task.kind == DEPTH:
            return Samples(learner, chosen[0]), Samples(learner, chosen[1] or chosen[0])
        parts = [_large(part or chosen[0], 4 * learner.input_size) for part in chosen]
    train_part, validation = (samples_of(learner, [part.sequence()]) for part in parts)
    return train_part, validation


def unitycam(folder: Path) -> list[FrameSequence]:
    """Frames of VR-Caps, as published with EndoSLAM, with depth up to scale.

    Their depth images are bright for a near wall, in steps that grow with distance, as in the
    reversed depth buffer of Unity, which falls with 1 / z. So depth is the inverse of the
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
