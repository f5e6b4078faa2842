"""Training of a learner in a folder: checkpoints, progress, pictures, the best weights."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from vrcaps.config.convert import to_plain
from vrcaps.config.limits import Range, check_fields
from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.core.files import atomic_write, write_csv
from vrcaps.learn.checkpoint import TrainedNetwork, write_weights
from vrcaps.learn.initialize import IMAGENET, initialized_network, origin
from vrcaps.learn.networks import freeze_batch_norm, require_torch
from vrcaps.learn.optimized import NetworkOptimizer
from vrcaps.learn.registry import AnyTask
from vrcaps.learn.samples import Samples, batch_of
from vrcaps.learn.task import Adversarial
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.learn.validation import validate, write_pictures
from vrcaps.training.folder import begin_training
from vrcaps.training.threads import exact_torch

CHECKPOINT, PROGRESS = "checkpoint.pt", "progress.csv"
WEIGHTS, BEST = "weights.safetensors", "best.safetensors"
_PACKAGES = ("numpy", "pillow", "segmentation-models-pytorch", "timm", "torch")
"""Packages that a training's bytes depend on."""
_WARM_UP = 0.05
"""Fraction of the steps in which the learning rate rises."""
_ADVERSARIAL_MOMENTUM = 0.5
"""First beta coefficient of AdamW in adversarial training (Radford, ICLR 2016)."""


@dataclass(frozen=True)
class TrainSettings:
    """All settings that determine a training's result, besides the files of its data.

    Attributes:
        learner: The task and its settings.
        data: Sources of the training data, as given on the command line.
        validation: Validation data, likewise; empty holds out part of the training data.
        start: `imagenet`, `scratch`, or a checkpoint to fine-tune: a file, or a published name.
        steps: Number of training steps.
        batch: Batch size, in frames.
        rate: Maximum learning rate of AdamW, after a linear warm-up; cosine decay to zero.
        weight_decay: Weight decay of AdamW.
        fraction: Fraction of the training frames that is used, for learning curves.
        evaluate_every: Steps between evaluations and checkpoints.
        evaluation_frames: Maximum number of frames of an evaluation, evenly spaced.
        freeze_batch_norm: Whether batch normalization keeps its initial statistics. Otherwise the
            brightness of a small batch, and with it absolute depth, is partly normalized away. Use
            it for fine-tuning, not when training from scratch.
        seed: Random seed.
    """

    learner: AnyTask = field(default_factory=DepthTask)
    data: tuple[str, ...] = ()
    validation: tuple[str, ...] = ()
    start: str = IMAGENET
    steps: Annotated[int, Range(1)] = 20_000
    batch: Annotated[int, Range(1)] = 8
    rate: Annotated[float, Range(above=0.0)] = 5e-4
    weight_decay: Annotated[float, Range(0.0)] = 1e-2
    fraction: Annotated[float, Range(above=0.0, max=1.0)] = 1.0
    evaluate_every: Annotated[int, Range(1)] = 500
    evaluation_frames: Annotated[int, Range(1)] = 400
    freeze_batch_norm: bool = False
    seed: Annotated[int, Range(0)] = 0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        step: Number of completed steps.
        total: Total number of steps.
        rows: A row for each evaluation: mean loss since the previous one, and the metrics.
        best: Best value of the learner's metric; None before the first evaluation.
    """

    step: int
    total: int
    rows: tuple[dict[str, float], ...] = ()
    best: float | None = None


@dataclass(frozen=True)
class ComputeSettings:
    """Compute settings: device and number of threads.

    Attributes:
        device: `cpu`, `cuda`, `mps`, or `auto` for the fastest available.
        threads: PyTorch threads on a CPU; more than one is slower on a machine with other load.
    """

    device: str = "auto"
    threads: Annotated[int, Range(1)] = 1

    def __post_init__(self) -> None:
        check_fields(self)


def train(
    settings: TrainSettings,
    samples: Samples,
    validation: Samples,
    out: Path,
    *,
    machine: ComputeSettings | None = None,
    is_forced: bool = False,
    tensorboard: bool = False,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Progress:
    """Train a learner, or resume an interrupted training; bytes are reproducible on a CPU.

    `out` then holds `best.safetensors` of the best evaluation, `weights.safetensors` of the last,
    `settings.json`, `progress.csv`, `pictures/`, and `checkpoint.pt` to resume from.

    Args:
        settings: Settings of the training.
        samples: Training frames.
        validation: Validation frames, which select the best checkpoint.
        out: Folder: new, empty, or of the same training.
        machine: Compute settings; by default the fastest available device.
        is_forced: Resume even if vrcaps or a package has changed since the start of the training.
        tensorboard: Whether files for TensorBoard are written.
        report: Called after each step.

    Raises:
        InputError: If the folder holds something else, or the loss is not finite; the last good
            checkpoint is kept.
        MissingExtraError: If a package is not installed.
    """
    machine = machine or ComputeSettings()
    device = chosen_device(machine.device)
    plain = to_plain(settings, TrainSettings)
    plain["frames"] = [len(samples), len(validation)]
    begin_training(out, plain, _PACKAGES, is_forced=is_forced)
    samples = samples.subset(settings.fraction, settings.seed)
    if isinstance(settings.learner, ClassificationTask):
        settings.learner.require_classes(samples.frames)
    # Some operations of the learners have no deterministic implementation on a GPU.
    with exact_torch(machine.threads) if device == "cpu" else nullcontext():
        run = _Run(settings, samples, validation, out, device)
        writer = _writer(out / "tensorboard") if tensorboard else None
        report(run.progress)
        while run.progress.step < settings.steps:
            run.step()
            if run.is_due():
                run.evaluate(writer)
            report(run.progress)
    return run.progress


def chosen_device(device: str) -> str:
    """Resolve `auto` to a device, and check that a named one is available.

    Raises:
        InputError: If it is not available.
        MissingExtraError: If PyTorch is not installed.
    """
    torch = require_torch()
    there = ["cpu"]
    if torch.cuda.is_available():
        there.insert(0, "cuda")
    if torch.backends.mps.is_available():
        there.insert(0, "mps")
    if device == "auto":
        return there[0]
    if device.split(":", maxsplit=1)[0] not in there:
        raise InputError(f"The device is {device!r}. Here: {', '.join(sorted(there))}, auto.")
    return device


class _Run:
    """Networks in training, and their progress."""

    def __init__(
        self,
        settings: TrainSettings,
        samples: Samples,
        validation: Samples,
        out: Path,
        device: str,
    ) -> None:
        torch = require_torch()
        self.settings, self.samples, self.validation = settings, samples, validation
        self.out, self.device, self.learner = out, device, settings.learner
        torch.manual_seed(settings.seed)
        # The channels-last memory format reduces the time of convolutions to two thirds.
        self.network = initialized_network(settings.learner, settings.start).to(
            device, memory_format=torch.channels_last
        )
        self._origin = origin(settings.start)
        self.adversary = _adversary(settings, device)
        self.learning = _optimized(settings, self.network, self.adversary)
        self.progress = Progress(0, settings.steps)
        self._losses: list[float] = []
        self._began = time.perf_counter()
        self._read_checkpoint()

    def step(self) -> None:
        """Train on one batch."""
        torch = require_torch()
        number = self.progress.step
        torch.manual_seed(int(rng.stream(self.settings.seed, "learn/step", number).integers(2**31)))
        self.network.train()
        if self.settings.freeze_batch_norm:
            freeze_batch_norm(self.network)
        batch = batch_of(self._samples_of(number), self.device)
        with torch.autocast(self.device.split(":")[0], torch.bfloat16, self.device != "cpu"):
            losses = self._losses_of(batch)
        value = losses[0].item()
        if not all(math.isfinite(loss.item()) for loss in losses):
            raise InputError(
                f"The loss is {value} at step {number}. {self.out / BEST} and the last "
                "checkpoint are kept. Try a smaller --set rate."
            )
        for part, loss in zip(self.learning, losses, strict=True):
            part.learn(loss, self._rate(number))
        self._losses.append(value)
        self.progress = Progress(
            number + 1, self.settings.steps, self.progress.rows, self.progress.best
        )

    def _losses_of(self, batch: Any) -> list[Any]:
        """Loss of each trained network."""
        if self.adversary is None or not isinstance(self.learner, Adversarial):
            return [self.learner.loss(self.network, batch)["loss"]]
        both = self.learner.losses(self.network, self.adversary, batch)
        return [terms["loss"] for terms in both]

    def is_due(self) -> bool:
        """Return whether an evaluation is due."""
        done = self.progress.step
        return done % self.settings.evaluate_every == 0 or done == self.settings.steps

    def evaluate(self, writer: Any) -> None:
        """Evaluate, keep the best weights, and write the checkpoint."""
        trained = TrainedNetwork(self.learner, self.network.eval(), {}, self.device, threads=None)
        found = validate(trained, self.validation, self.settings.evaluation_frames)
        value, progress = found.scores[self.learner.figure.name], self.progress
        row = {
            "step": float(progress.step),
            "training_loss": float(np.mean(self._losses)),
            **found.scores,
            "skipped": float(len(self.samples.skipped) + len(self.validation.skipped)),
            "seconds": time.perf_counter() - self._began,
        }
        best = progress.best
        about = {"steps": progress.step, "scores": dict(found.scores)}
        about |= {"data": list(self.settings.data), "origin": self._origin}
        if best is None or self.learner.figure.is_better(value, best):
            best = value
            write_weights(self.out / BEST, self.learner, self.network, about)
        if progress.step == progress.total:
            write_weights(self.out / WEIGHTS, self.learner, self.network, about)
        picture = self.out / "pictures" / f"step-{progress.step:07d}.png"
        shown = write_pictures(picture, self.learner, found)
        self.progress = Progress(progress.step, progress.total, (*progress.rows, row), best)
        self._losses, self._began = [], time.perf_counter()
        self._write_checkpoint()
        if writer is not None:
            for name, number in row.items():
                writer.add_scalar(f"evaluation/{name}", number, progress.step)
            writer.add_image("pictures", shown, progress.step, dataformats="HWC")
            writer.flush()

    def _samples_of(self, number: int) -> list[Any]:
        """Augmented samples of a batch; the same for the same index."""
        count, size = len(self.samples), self.settings.batch
        places = np.arange(number * size, (number + 1) * size)
        orders = {
            epoch: rng.stream(self.settings.seed, "learn/order", int(epoch)).permutation(count)
            for epoch in np.unique(places // count)
        }
        chance = rng.stream(self.settings.seed, "learn/augment", number)
        return [
            self.learner.augmented(self.samples.next(int(orders[p // count][p % count])), chance)
            for p in places
        ]

    def _rate(self, number: int) -> float:
        done = number / self.settings.steps
        warm = min(1.0, (number + 1) / max(1.0, _WARM_UP * self.settings.steps))
        return self.settings.rate * warm * 0.5 * (1.0 + math.cos(math.pi * done))

    def _write_checkpoint(self) -> None:
        torch = require_torch()
        write_csv(self.out / PROGRESS, self.progress.rows)
        network, *others = (part.state() for part in self.learning)
        state = {
            **network,
            "adversaries": others,
            "progress": {**asdict(self.progress), "rows": list(self.progress.rows)},
        }
        with atomic_write(self.out / CHECKPOINT) as temporary:
            torch.save(state, temporary)

    def _read_checkpoint(self) -> None:
        torch, path = require_torch(), self.out / CHECKPOINT
        if not path.is_file():
            return
        try:
            state = torch.load(path, map_location=self.device, weights_only=True)
            known = [state, *state.get("adversaries", [])]
            for part, one in zip(self.learning, known, strict=True):
                part.load(one)
            found = state["progress"]
            self.progress = Progress(**{**found, "rows": tuple(found["rows"])})
        except Exception as error:  # errors of a damaged pickle have no common base
            reason = str(error).splitlines()[0]
            raise InputError(f"{path} is damaged ({reason}). Give a new folder.") from error


def _adversary(settings: TrainSettings, device: str) -> Any | None:
    """Discriminator of the learner; None for most learners."""
    found = settings.learner.adversary() if isinstance(settings.learner, Adversarial) else None
    return None if found is None else found.to(device)


def _optimized(
    settings: TrainSettings, network: Any, adversary: Any | None
) -> list[NetworkOptimizer]:
    """The networks to train, each with its optimizer."""
    decay = settings.weight_decay
    if adversary is None:
        return [NetworkOptimizer(network, weight_decay=decay)]
    return [
        NetworkOptimizer(one, weight_decay=decay, momentum=_ADVERSARIAL_MOMENTUM)
        for one in (network, adversary)
    ]


def _writer(folder: Path) -> Any:
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(folder))
