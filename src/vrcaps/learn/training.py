"""Training of a network in a folder: checkpoints, progress, pictures, the best weights."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from vrcaps.config.convert import to_plain
from vrcaps.core import rng
from vrcaps.core.errors import InputError
from vrcaps.core.files import atomic_write, write_csv
from vrcaps.learn.checkpoint import TrainedNetwork, write_weights
from vrcaps.learn.evaluation import evaluate, write_pictures
from vrcaps.learn.initialize import initialized_network, mean_with_start, origin
from vrcaps.learn.networks import freeze_batch_norm
from vrcaps.learn.samples import Samples, batch_of
from vrcaps.learn.settings import IMAGENET, SCRATCH, TrainSettings, current_training
from vrcaps.learn.task import Batch, Sample
from vrcaps.training import (
    PROGRESS,
    ComputeSettings,
    Progress,
    available_device,
    begin_training,
    exact_torch,
    restoring,
    run_training,
)

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

CHECKPOINT = "checkpoint.pt"
WEIGHTS, BEST = "weights.safetensors", "best.safetensors"
_PACKAGES = ("numpy", "pillow", "segmentation-models-pytorch", "timm", "torch")
"""Packages that a training's bytes depend on."""
_ALIVE_FRAMES = 4
"""Number of validation frames on which features are compared."""
_WARM_UP = 0.05
"""Fraction of the steps in which the learning rate rises."""
_MAX_GRADIENT = 1.0
"""Maximum norm of the gradients, by clipping."""
_MOMENTUM, _ADVERSARIAL_MOMENTUM = 0.9, 0.5
"""First beta coefficient of AdamW, and in adversarial training (Radford, ICLR 2016)."""


def train(
    settings: TrainSettings,
    samples: Samples,
    validation: Samples,
    out: Path,
    *,
    compute: ComputeSettings | None = None,
    is_forced: bool = False,
    tensorboard: bool = False,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Progress:
    """Train a network, or resume an interrupted training; on a CPU to the same bytes.

    `out` then holds `best.safetensors` of the best evaluation, `weights.safetensors` of the last,
    `settings.json`, `progress.csv`, `pictures/`, and `checkpoint.pt` to resume from.

    Args:
        settings: Settings of the training.
        samples: Training frames.
        validation: Validation frames, which select the best checkpoint.
        out: Folder: new, empty, or of the same training.
        compute: Compute settings; by default the fastest available device.
        is_forced: Resume even if vrcaps or a package has changed since the start of the training.
        tensorboard: Whether files for TensorBoard are written.
        report: Called after each step.

    Raises:
        InputError: If the folder contains other files, a mean with the start has no checkpoint to
            start from, the loss is not finite, or a layer has the same features for all images; the
            last good checkpoint is kept.
        MissingExtraError: If a package is not installed.
    """
    fraction = settings.average_with_start
    if fraction < 1.0 and settings.start in (SCRATCH, IMAGENET):
        raise InputError(
            f"average_with_start is {fraction:g}, but training starts from {settings.start}. "
            "Allowed: 1, or --start with a checkpoint of the same task."
        )
    compute = compute or ComputeSettings()
    device = available_device(compute.device)
    plain = to_plain(settings, TrainSettings)
    plain["frames"] = [len(samples), len(validation)]
    begin_training(out, plain, _PACKAGES, is_forced=is_forced, update=current_training)
    samples = samples.subset(settings.fraction, settings.seed)
    settings.task.require(samples.frames)
    # Some operations of the networks have no deterministic implementation on a GPU.
    with exact_torch(compute.threads) if device == "cpu" else nullcontext():
        run = _Run(settings, samples, validation, out, device)
        run.log_to(_writer(out / "tensorboard") if tensorboard else None)
        return run_training(run, report)


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
        self.settings, self.samples, self.validation = settings, samples, validation
        self.out, self.device, self.task = out, device, settings.task
        torch.manual_seed(settings.seed)
        # The channels-last memory format reduces the time of convolutions to two thirds.
        self.network = initialized_network(self.task, settings.start).to(
            device,
            memory_format=torch.channels_last,  # pyright: ignore[reportCallIssue]
        )
        is_mean = settings.average_with_start < 1.0
        self._start = copy.deepcopy(self.network.state_dict()) if is_mean else {}
        self._origin = origin(settings.start)
        discriminator = self.task.discriminator()
        self.discriminator = None if discriminator is None else discriminator.to(device)
        self.optimizers = self._make_optimizers()
        self.progress = Progress(0, settings.steps)
        self._writer: SummaryWriter | None = None
        self._losses: list[float] = []
        self._began = time.perf_counter()
        self._read_checkpoint()

    def log_to(self, writer: SummaryWriter | None) -> None:
        """Write the metrics of evaluations to TensorBoard as well."""
        self._writer = writer

    def advance(self) -> None:
        """Train on one batch, and evaluate if it is due."""
        self._step()
        done = self.progress.step
        if done % self.settings.evaluate_every == 0 or done == self.settings.steps:
            self._evaluate()

    def _step(self) -> None:
        """Train on one batch."""
        index = self.progress.step
        torch.manual_seed(int(rng.stream(self.settings.seed, "learn/step", index).integers(2**31)))
        self.network.train()
        if self.settings.freeze_batch_norm:
            freeze_batch_norm(self.network)
        batch = batch_of(self._samples_of(index), self.device)
        with torch.autocast(self.device.split(":")[0], torch.bfloat16, self.device != "cpu"):
            losses = self._losses_of(batch)
        value = losses[0].item()
        if not all(math.isfinite(loss.item()) for loss in losses):
            raise InputError(
                f"The loss is {value} at step {index}. {self.out / BEST} and the last checkpoint "
                "are kept. Try a smaller --set learning_rate."
            )
        for optimizer, loss in zip(self.optimizers, losses, strict=True):
            optimizer.step(loss, self._learning_rate(index))
        self._losses.append(value)
        self.progress = replace(self.progress, step=index + 1)

    def _losses_of(self, batch: Batch) -> list[Tensor]:
        """Loss of each trained network."""
        if self.discriminator is None:
            return [self.task.loss(self.network, batch)["loss"]]
        both = self.task.adversarial_losses(self.network, self.discriminator, batch)
        return [terms["loss"] for terms in both]

    def _evaluate(self) -> None:
        """Evaluate, keep the best weights, and write the checkpoint."""
        network = self._averaged().eval()
        trained = TrainedNetwork(self.task, network, {}, self.device, threads=None)
        result = evaluate(trained, self.validation, self.settings.evaluation_frames)
        require_alive(trained, _spread(result.samples), self.progress.step)
        progress = self.progress
        row = {
            "step": float(progress.step),
            "training_loss": float(np.mean(self._losses)),
            **result.metrics,
            "skipped": float(len(self.samples.skipped) + len(self.validation.skipped)),
            "seconds": time.perf_counter() - self._began,
        }
        value, best = result.metrics[self.task.metric.name], progress.best
        about = {"steps": progress.step, "scores": dict(result.metrics)}
        about |= {"data": list(self.settings.data), "origin": self._origin}
        if best is None or self.task.metric.is_better(value, best):
            best = value
            write_weights(self.out / BEST, self.task, network, about)
        if progress.step == progress.total:
            write_weights(self.out / WEIGHTS, self.task, network, about)
        picture = self.out / "pictures" / f"step-{progress.step:07d}.png"
        pixels = write_pictures(picture, self.task, result)
        self.progress = replace(progress, rows=(*progress.rows, row), best=best)
        self._losses, self._began = [], time.perf_counter()
        self._write_checkpoint()
        if self._writer is not None:
            for name, number in row.items():
                self._writer.add_scalar(f"evaluation/{name}", number, progress.step)
            self._writer.add_image("pictures", pixels, progress.step, dataformats="HWC")
            self._writer.flush()

    def _averaged(self) -> nn.Module:
        """Network of the mean of the trained parameters and those at the start."""
        if not self._start:
            return self.network
        return mean_with_start(self.network, self._start, self.settings.average_with_start)

    def _samples_of(self, index: int) -> list[Sample]:
        """Augmented samples of a batch; the same for the same index."""
        count, size = len(self.samples), self.settings.batch
        positions = np.arange(index * size, (index + 1) * size)
        orders = {
            epoch: rng.stream(self.settings.seed, "learn/order", int(epoch)).permutation(count)
            for epoch in np.unique(positions // count)
        }
        draw = rng.stream(self.settings.seed, "learn/augment", index)
        return [
            self.task.augment(self.samples.next(int(orders[p // count][p % count])), draw)
            for p in positions
        ]

    def _learning_rate(self, index: int) -> float:
        done = index / self.settings.steps
        warm = min(1.0, (index + 1) / max(1.0, _WARM_UP * self.settings.steps))
        return self.settings.learning_rate * warm * 0.5 * (1.0 + math.cos(math.pi * done))

    def _make_optimizers(self) -> list[_NetworkOptimizer]:
        decay = self.settings.weight_decay
        if self.discriminator is None:
            return [_NetworkOptimizer(self.network, decay, _MOMENTUM)]
        both = (self.network, self.discriminator)
        return [_NetworkOptimizer(one, decay, _ADVERSARIAL_MOMENTUM) for one in both]

    def _write_checkpoint(self) -> None:
        write_csv(self.out / PROGRESS, self.progress.rows)
        network, *others = (one.state() for one in self.optimizers)
        state = {
            **network,
            "discriminators": others,
            "progress": {**asdict(self.progress), "rows": list(self.progress.rows)},
        }
        with atomic_write(self.out / CHECKPOINT) as temporary:
            torch.save(state, temporary)

    def _read_checkpoint(self) -> None:
        path = self.out / CHECKPOINT
        if not path.is_file():
            return
        with restoring(path):
            state = torch.load(path, map_location=self.device, weights_only=True)
            others = state.get("discriminators", state.get("adversaries", []))  # former name
            for optimizer, one in zip(self.optimizers, [state, *others], strict=True):
                optimizer.load(one)
            progress = state["progress"]
            self.progress = Progress(**{**progress, "rows": tuple(progress["rows"])})


def _spread(samples: Sequence[Sample]) -> list[Sample]:
    """A few evenly spaced samples of the size of the first."""
    chosen = np.unique(np.linspace(0, len(samples) - 1, _ALIVE_FRAMES).astype(int))
    alike = [samples[k] for k in chosen if samples[k]["image"].shape == samples[0]["image"].shape]
    return [{k: v for k, v in one.items() if isinstance(v, np.ndarray)} for one in alike]


class _NetworkOptimizer:
    """A network that AdamW optimizes."""

    def __init__(self, network: nn.Module, weight_decay: float, momentum: float) -> None:
        self.network = network
        self.optimizer = torch.optim.AdamW(
            network.parameters(), betas=(momentum, 0.999), weight_decay=weight_decay
        )

    def step(self, loss: Tensor, learning_rate: float) -> None:
        """Take one gradient step on a loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), _MAX_GRADIENT)
        self.optimizer.step()

    def state(self) -> dict[str, Any]:
        """State for a checkpoint."""
        return {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        """Restore a state."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])


def _writer(folder: Path) -> SummaryWriter:
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(folder))


def dead_features(trained: TrainedNetwork, samples: Sequence[Sample]) -> dict[str, float]:
    """Fraction of dead input features of each convolution and linear layer, by its name.

    A feature is dead if it has one value for all samples and positions, such as after a ReLU whose
    inputs are all negative. No gradient passes such an activation, so it stays dead.

    Args:
        trained: Task and network.
        samples: Two or more samples whose images differ.
    """
    fractions: dict[str, float] = {}

    def observe(name: str) -> object:
        def hook(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
            values = inputs[0].detach().float()
            values = values.transpose(0, 1) if values.ndim == 4 else values.movedim(-1, 0)
            flat = values.flatten(1)
            is_dead = flat.amax(dim=1) == flat.amin(dim=1)
            fractions[name] = max(fractions.get(name, 0.0), float(is_dead.float().mean()))

        return hook

    hooks = [
        module.register_forward_pre_hook(observe(name))  # type: ignore[arg-type]
        for name, module in trained.network.named_modules()
        if isinstance(module, nn.Conv2d | nn.Linear)
    ]
    try:
        trained.outputs(batch_of(samples, trained.device))
    finally:
        for hook in hooks:
            hook.remove()
    return fractions


def require_alive(trained: TrainedNetwork, samples: Sequence[Sample], step: int) -> None:
    """Check that no layer of a network has only dead input features.

    Args:
        trained: Task and network.
        samples: Samples of the evaluation; equal images are not compared.
        step: Number of training steps, for the message.

    Raises:
        InputError: If a layer is dead.
    """
    distinct = {sample["image"].tobytes(): sample for sample in samples}
    if len(distinct) < 2:
        return
    for name, fraction in dead_features(trained, list(distinct.values())).items():
        if fraction == 1.0:
            raise InputError(
                f"The network is dead at step {step}: all inputs of its layer {name} are the same "
                "for all images. Start again with a smaller --set learning_rate, another --set "
                "seed, or other --start weights."
            )
