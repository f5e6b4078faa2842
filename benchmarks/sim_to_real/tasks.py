"""Tasks of the experiment: prediction, real images, duration of training, and metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.sim_to_real.cells import LONG
from benchmarks.sim_to_real.general import GENERAL
from benchmarks.sim_to_real.images import Pictures
from benchmarks.sim_to_real.real import (
    bleeding_class,
    kvasir_class,
    read_classes,
    read_large,
    read_masks,
)
from vrcaps.learn.augment import Augmentation
from vrcaps.learn.evaluation import EvaluationResult
from vrcaps.learn.networks import Backbone
from vrcaps.learn.task import Sample
from vrcaps.learn.task import Task as NetworkTask
from vrcaps.learn.tasks.classification import ClassificationTask, class_probabilities
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.learn.tasks.segmentation import LESION, SegmentationTask
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask, image_of
from vrcaps.metrics.images import psnr, ssim
from vrcaps.metrics.labels import dice
from vrcaps.recording.frame_sequence import NORMAL

FRACTIONS = (0.1, 1.0, 0.25, 0.05, 0.5)
"""Fractions of the real training images, the most informative first."""
DEPTH = "depth"
OUR_LESIONS = ("polyp", "bleeding", "colitis", "ulcer")
"""Kinds of lesions that masks are learned of on ours."""
OUR_CLASSES = (NORMAL, *OUR_LESIONS)
"""Classes that are learned on ours."""


@dataclass(frozen=True)
class Effort:
    """Length of a training, and the size of its images.

    Attributes:
        size: Side of the images, or of the large crops of super-resolution [px].
        steps: Batches of real images.
        first_steps: Batches of other images before.
        batch: Images in a batch.
        rate: Largest learning rate.
    """

    size: int
    steps: int
    first_steps: int
    batch: int
    rate: float = 1e-3


PRESETS: Mapping[str, Mapping[str, Effort]] = {
    "quick": {
        "classes": Effort(size=96, steps=100, first_steps=2500, batch=8),
        "masks": Effort(size=64, steps=100, first_steps=4000, batch=8),
        "super-resolution": Effort(size=96, steps=100, first_steps=400, batch=8),
        "depth": Effort(size=96, steps=0, first_steps=300, batch=8),
    },
    "short": {
        "classes": Effort(size=96, steps=100, first_steps=300, batch=8),
        "masks": Effort(size=64, steps=100, first_steps=400, batch=8),
        "super-resolution": Effort(size=96, steps=100, first_steps=400, batch=8),
        "depth": Effort(size=96, steps=0, first_steps=300, batch=8),
    },
    "full": {
        "classes": Effort(size=192, steps=2000, first_steps=10_000, batch=32, rate=5e-4),
        "masks": Effort(size=192, steps=3000, first_steps=20_000, batch=16, rate=5e-4),
        "super-resolution": Effort(size=192, steps=5000, first_steps=30_000, batch=16, rate=2e-4),
        "depth": Effort(size=192, steps=0, first_steps=20_000, batch=16, rate=5e-4),
    },
    "smoke": {
        "classes": Effort(size=32, steps=2, first_steps=2, batch=4),
        "masks": Effort(size=32, steps=2, first_steps=2, batch=4),
        "super-resolution": Effort(size=32, steps=2, first_steps=2, batch=2),
        "depth": Effort(size=32, steps=0, first_steps=2, batch=2),
    },
}
"""`quick`: half a minute of one processor for a network, once half an hour for what is learned
before; `short`: minutes for that, for ablations, where each network learns before; `full`: what a
GPU is for; `smoke`: seconds, shows that all works, no more."""


@dataclass(frozen=True)
class Task:
    """A task on real images.

    Attributes:
        name: Of the task and its real images.
        kind: Task of the learner.
        layout: Real images that it is learned from and judged by.
        kinds: Classes, or kinds of lesions in our masks.
        title: Title on the page.
        figure: Name of the compared metric.
        unit: Of a difference: `points` are hundredths.
        has_overlays: Whether recorders print into the corners of its real images.
    """

    name: str
    kind: str
    layout: str
    kinds: tuple[str, ...]
    title: str
    figure: str
    unit: str = "points"
    has_overlays: bool = False

    @property
    def arms(self) -> tuple[str, ...]:
        """Initialization of the training on real images."""
        if self.kind == "super-resolution":
            return ("scratch", "ours", "unitycam", GENERAL)
        arms = ("scratch", "imagenet", "ours", "imagenet+ours")
        return (*arms, LONG) if self.kind == "classes" else arms

    @property
    def lesions(self) -> tuple[str, ...]:
        """Kinds of lesions among its classes."""
        return tuple(kind for kind in self.kinds if kind != "normal")

    def first_learners(self, effort: Effort) -> tuple[NetworkTask, ...]:
        """Tasks of the pre-training on simulated images, in order.

        One network learned masks of all kinds of lesions. It went on to masks of any lesion, with
        which all tasks of masks begin, and to classes of images, for those of classes: a mask says
        where in the image the lesion is, a class only that there is one, and what else goes with
        it in our images. Colors vary more than in later learning, since walls of real patients do.
        """
        if self.kind not in ("classes", "masks"):
            return (self.learner(effort),)
        backbone, colors = Backbone(effort.size), {"exposure_jitter": 1.5, "color_jitter": 1.35}
        kinds = SegmentationTask(
            OUR_LESIONS, backbone=backbone, augmentation=Augmentation(**colors)
        )
        if self.kind == "masks":
            return kinds, replace(kinds, classes=(LESION,))
        return kinds, ClassificationTask(
            OUR_CLASSES, backbone=backbone, augmentation=Augmentation(**colors, min_crop=0.7)
        )

    def learner(self, effort: Effort) -> NetworkTask:
        """Task settings for images of a preset's size."""
        if self.kind == "classes":
            return ClassificationTask(classes=self.kinds, backbone=Backbone(effort.size))
        if self.kind == "masks":
            return SegmentationTask(classes=self.kinds, backbone=Backbone(effort.size))
        if self.kind == DEPTH:
            return DepthTask(backbone=Backbone(effort.size))
        return SuperResolutionTask(
            size=effort.size, validation_size=4 * effort.size, blocks=6, features=32
        )

    def read(self, folder: Path, effort: Effort) -> Pictures:
        """The real images, in memory."""
        return _read(self, folder, effort)

    def values(self, found: EvaluationResult) -> dict[str, list[float]]:
        """Values of each evaluated image from which the metric is computed."""
        pairs = list(zip(found.outputs, found.samples, strict=True))
        if self.kind == "classes":
            chance = class_probabilities(np.stack(found.outputs))[:, 1]
            truth = [float(sample["class"]) for sample in found.samples]
            return {"truth": truth, "chance": _rounded(chance)}
        if self.kind == "masks":
            scores = [dice(output[0] > 0.0, s["mask"][..., 0] == 1) for output, s in pairs]
            return {"dice": _rounded(scores)}
        rows = [_quality(output, sample) for output, sample in pairs]
        names = ("psnr", "ssim", "psnr_bicubic", "ssim_bicubic")
        columns = zip(*rows, strict=True)
        return {name: _rounded(each) for name, each in zip(names, columns, strict=True)}

    def features(self, values: Mapping[str, Sequence[float]], name: str = "") -> np.ndarray:
        """Terms of each image [n k]; a metric is a function of their sums.

        Args:
            values: Of the images that were judged.
            name: Name of the metric; by default the compared one of the task.
        """
        if self.kind == "classes":
            truth, chance = np.array(values["truth"], int), np.array(values["chance"])
            return np.eye(4)[2 * truth + (chance > 0.5)]
        figures = np.array(values[name or {"masks": "dice"}.get(self.kind, "psnr")])
        return np.column_stack([figures, np.ones_like(figures)])

    def figure_of(self, sums: np.ndarray) -> np.ndarray:
        """Metric [b] of sums of terms [b k]: mean F1 of two classes, or a mean."""
        if self.kind != "classes":
            return sums[:, 0] / sums[:, 1]
        true_0, false_1, false_0, true_1 = sums.T
        wrong = false_0 + false_1
        each = [2.0 * true / np.maximum(2.0 * true + wrong, 1e-9) for true in (true_0, true_1)]
        return np.mean(each, axis=0)


def _quality(output: np.ndarray, sample: Sample) -> list[float]:
    """PSNR [dB] and SSIM of the output, then of bicubic enlargement, without a border of 4 px."""
    truth = sample["truth"]
    size = (truth.shape[1], truth.shape[0])
    bicubic = Image.fromarray(sample["image"]).resize(size, Image.Resampling.BICUBIC)
    return [
        measure(image, truth, data_range=255.0, crop=4)
        for image in (image_of(output), np.asarray(bicubic))
        for measure in (psnr, ssim)
    ]


def _rounded(values: Any) -> list[float]:
    return np.round(np.asarray(values, float), 5).tolist()


@cache
def _read(task: Task, folder: Path, effort: Effort) -> Pictures:
    if task.kind == "classes":
        class_of = bleeding_class if task.layout == "wce_bleedgen" else kvasir_class
        return read_classes(folder, class_of, effort.size, has_overlays=task.has_overlays)
    if task.kind == "masks":
        return read_masks(folder, effort.size, task.kinds[0])
    return read_large(folder, 4 * effort.size)


TASKS = {
    task.name: task
    for task in (
        Task(
            "polyp-masks", "masks", "kvasir_seg", ("polyp",),
            "Segmentation of polyps (Kvasir-SEG)", "Dice",
        ),
        Task(
            "bleeding-masks", "masks", "wce_bleedgen", ("bleeding",),
            "Segmentation of bleeding (WCEBleedGen, capsule)", "Dice",
        ),
        Task(
            "bleeding-classes", "classes", "wce_bleedgen", ("normal", "bleeding"),
            "Classification of bleeding (WCEBleedGen, capsule)", "mean F1",
        ),
        Task(
            "polyp-classes", "classes", "hyperkvasir", ("polyp", "colitis"),
            "Classification of polyps and colitis (HyperKvasir)", "mean F1", has_overlays=True,
        ),
        Task(
            "super-resolution", "super-resolution", "bkai", (),
            "Super-resolution ×4 (BKAI-IGH NeoPolyp)", "PSNR", unit="dB",
        ),
    )
}  # fmt: skip
"""Tasks by name, in the order in which the cells of one fraction and seed run."""
DEPTH_TASK = Task(DEPTH, DEPTH, "c3vd", (), "Depth without any real frame", "AbsRel")


def task_named(name: str) -> Task:
    """Task with a name: one of `TASKS`, or depth."""
    return DEPTH_TASK if name == DEPTH else TASKS[name]
