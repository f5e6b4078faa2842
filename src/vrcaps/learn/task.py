"""Base class of the tasks: samples of frames, a network, a loss, and metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeAlias, TypeVar, cast

import numpy as np
from torch import Tensor, nn

from vrcaps.config.convert import register_family
from vrcaps.learn.networks import Backbone
from vrcaps.learn.perturbation import Perturbation
from vrcaps.learn.picture_border import Letterbox
from vrcaps.learn.registry import TASKS
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.learn.picture_border import PictureView

Terms = TypeVar("Terms")
"""Part of a task's metrics that depends on one frame alone."""
MAX_CLASSES = 1000
"""Maximum number of classes of a network."""
MAX_WEIGHT = 1e6
"""Maximum weight of a loss term."""
Sample: TypeAlias = dict[str, Any]
"""Arrays of one frame at the network's size; `image` is uint8 [s s 3]. Values that are not arrays
are used by the loss only."""
Batch: TypeAlias = dict[str, Any]
"""Tensors [b c s s] or [b ...] of samples of one size; values that are not arrays are lists."""
Losses: TypeAlias = dict[str, Tensor]
"""Loss terms by name; `loss` is their sum."""
Presets: TypeAlias = Mapping[str, Mapping[str, Any]]
"""Changes of the settings of a training by preset: plain values by dotted path."""
INPUTS = {
    "image": "color from 0 to 1, sRGB [b 3 s s]",
    "ray": "unit ray of each pixel in the camera's frame (x right, y down, z forward), zero where "
    "the lens has none [b 3 s s]",
}
"""Descriptions of the network inputs, by name."""


@dataclass(frozen=True)
class Metric:
    """Metric by which the best checkpoint is selected.

    Attributes:
        name: Name of one of the task's metrics, or `loss`.
        is_error: Whether smaller is better.
    """

    name: str
    is_error: bool

    def is_better(self, value: float, best: float | None) -> bool:
        """Return whether a value is better than the best so far; NaN never is."""
        if not np.isfinite(value):
            return False
        return best is None or (value < best if self.is_error else value > best)


class Task(Generic[Terms]):
    """One task on images. Subclasses are frozen dataclasses whose fields are the task's settings.

    `TASKS.register` adds a subclass to the command line and lets checkpoints name it.

    Attributes:
        kind: Name of the task on the command line and in checkpoints.
        input_names: Arrays of a sample that are the network's inputs, in this order.
        optional_inputs: Arrays of a sample that `output` uses if they are present.
        output_text: Description of the network's output, with unit and shape.
        metric: Metric by which the best checkpoint is selected.
        presets: Changes of the settings of a training by preset.
        fallback_class: Class from which classes missing from a checkpoint are initialized.
        similar_tasks: Tasks whose checkpoints initialize all parameters of the same name and shape.
        reads_sequences: Whether `sequence_files` processes the frames of a prediction again.
        predicts_lengths: Whether the network infers lengths: its input is then the tissue alone, at
            the camera's own exposure.
        free_axes: Axes of the inputs and the output of any size, by index, for ONNX.
        pipeline_tag: Task of https://huggingface.co/tasks, for model cards; empty if there is none.
    """

    kind: ClassVar[str]
    input_names: ClassVar[tuple[str, ...]] = ("image",)
    optional_inputs: ClassVar[tuple[str, ...]] = ()
    output_text: ClassVar[str]
    metric: ClassVar[Metric]
    presets: ClassVar[Presets] = {}
    fallback_class: ClassVar[str] = ""
    similar_tasks: ClassVar[tuple[str, ...]] = ()
    predicts_lengths: ClassVar[bool] = False
    reads_sequences: ClassVar[bool] = False
    free_axes: ClassVar[Mapping[int, str]] = {0: "batch"}
    pipeline_tag: ClassVar[str] = ""

    @property
    def input_size(self) -> int:
        """Side of the network's input images [px]."""
        raise NotImplementedError

    @property
    def encoder(self) -> str | None:
        """Encoder that checkpoints of other tasks may initialize; None if there is none."""
        return None

    def prepare(self, sequence: FrameSequence) -> FrameSequence:
        """Return a sequence with values that are read once for all frames."""
        return sequence

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return the indices of the frames of a sequence that can be used for training.

        Raises:
            InputError: If the sequence lacks a required channel.
        """
        raise NotImplementedError

    def require(self, frames: Sequence[tuple[FrameSequence, int]]) -> None:
        """Check that training frames suffice for the task.

        Raises:
            InputError: If they do not.
        """

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the network's input and the ground truth of one frame.

        Raises:
            InputError: If an image cannot be read.
        """
        raise NotImplementedError

    def perturbed_sample(
        self, sequence: FrameSequence, index: int, perturbation: Perturbation
    ) -> Sample:
        """Return the sample of a perturbed frame, for tests of robustness.

        Raises:
            InputError: If an image cannot be read.
        """
        return self.sample(perturbation.sequence(sequence), index)

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Augment a sample and its labels."""
        return sample

    def network(self, *, is_pretrained: bool) -> nn.Module:
        """Create a network, with ImageNet weights if requested.

        Raises:
            MissingExtraError: If a package or the weights are not installed.
        """
        raise NotImplementedError

    def loss(self, network: nn.Module, batch: Batch) -> Losses:
        """Loss terms of a network on a batch."""
        raise NotImplementedError

    def discriminator(self) -> nn.Module | None:
        """Create a discriminator for adversarial training; None for training without one.

        It is trained to distinguish predictions from ground truth. Only training checkpoints
        contain it.
        """
        return None

    def adversarial_losses(
        self, network: nn.Module, discriminator: nn.Module, batch: Batch
    ) -> tuple[Losses, Losses]:
        """Loss terms of the network and of its discriminator."""
        raise NotImplementedError

    def metrics(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Compute metrics over samples, from the network's outputs [c s s] or [c]."""
        if type(self).summary is Task.summary:
            raise NotImplementedError
        return self.summary([self.terms(*pair) for pair in zip(outputs, samples, strict=True)])

    def terms(self, output: NDArray, sample: Sample) -> Terms:
        """Part of the metrics that depends on one frame alone, for `summary`.

        Resampling of frames repeats only `summary`. Without these two methods, a task's `metrics`
        is repeated.
        """
        return cast(Terms, (output, sample))

    def summary(self, terms: Sequence[Terms]) -> Mapping[str, float]:
        """Compute metrics from the terms of frames."""
        pairs = cast(Sequence[tuple[NDArray, Sample]], terms)
        outputs, samples = zip(*pairs, strict=True)
        return self.metrics(outputs, samples)

    def baselines(
        self, samples: Sequence[Sample], groups: Sequence[str]
    ) -> Mapping[str, Sequence[NDArray]]:
        """Outputs of trivial baselines for each sample, by name, in the network's format.

        Args:
            samples: Frames with ground truth.
            groups: Group of each frame, such as its patient.
        """
        return {}

    def sequence_errors(
        self, network: nn.Module, sequence: FrameSequence, device: str
    ) -> Mapping[str, Mapping[str, float]]:
        """Errors over a whole sequence by method, `network` and baselines; empty for no metric."""
        return {}

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], letterbox: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the network's input for an image without ground truth.

        Raises:
            InputError: If the network needs the camera and there is none.
        """
        return {"image": letterbox.image(image)}

    def view_inputs(self, view: PictureView) -> Sample:
        """Return the network's input for a part of an image, see `inputs`."""
        letterbox = Letterbox(view.image.shape[0], view.image.shape[1], self.input_size)
        return self.inputs(view.image, letterbox, view.camera)

    def outputs(self, network: nn.Module, batch: Batch) -> dict[str, Tensor]:
        """Return all outputs [b c ...] of a network for a batch of inputs, by name."""
        return {"output": self.output(network, batch)}

    def output(self, network: nn.Module, batch: Batch) -> Tensor:
        """Return the main output of a network in float32, independent of its compute type."""
        return network(*(batch[name] for name in self.input_names)).float()

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, ground truth if available, and output side by side, for inspection."""
        return sample["image"]

    def files(self, output: NDArray, letterbox: Letterbox) -> Mapping[str, NDArray]:
        """Output images of a prediction by file-name suffix."""
        return {}

    def row(self, output: NDArray) -> Mapping[str, object]:
        """Table columns of a prediction."""
        return {}

    def sequence_files(
        self,
        network: nn.Module,
        sequence: FrameSequence,
        frames: Sequence[int],
        *,
        device: str,
        on_frame: Callable[[], None],
    ) -> Mapping[str, bytes]:
        """Output files of a prediction for the given frames of a sequence, by name.

        `on_frame` is called after each frame if `reads_sequences` is true.
        """
        return {}


class BackboneTask(Task[Terms]):
    """Task whose network has a timm encoder.

    Attributes:
        backbone: Input size and encoder; a field of the subclass.
    """

    presets: ClassVar[Presets] = {"ci": {"task.backbone.size": 64}}
    backbone: Backbone

    @property
    def input_size(self) -> int:
        """Side of the network's input images [px]."""
        return self.backbone.size

    @property
    def encoder(self) -> str:
        """Encoder that checkpoints of other tasks may initialize."""
        return self.backbone.encoder


register_family(Task, TASKS)


def scalars(**values: float) -> Sample:
    """Scalar inputs of a sample."""
    return {name: np.array(value, np.float32) for name, value in values.items()}


def total(terms: Losses) -> Losses:
    """Add the sum of loss terms to them, as `loss`."""
    return {**terms, "loss": cast(Tensor, sum(terms.values()))}
