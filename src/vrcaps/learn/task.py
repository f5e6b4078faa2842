"""Protocol of a learner: samples of frames, a network, a loss, and metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

    from vrcaps.learn.letterbox import Letterbox

MAX_SIZE = 2048
"""Maximum side of a network's images [px], since a checkpoint may state any."""
MAX_CLASSES = 1000
"""Maximum number of classes of a network."""
MAX_WEIGHT = 1e6
"""Maximum weight of a loss term."""
Sample = dict[str, Any]
"""Arrays of one frame at the network's size; `image` is uint8 [s s 3]. Values that are not arrays
are used by the loss only."""
INPUTS = {
    "image": "color from 0 to 1, sRGB [b 3 s s]",
    "ray": "unit ray of each pixel in the camera's frame (x right, y down, z forward), zero where "
    "the lens has none [b 3 s s]",
}
"""Descriptions of the network inputs, by name."""
Batch = dict[str, Any]
"""Tensors [b c s s] or [b ...] of samples of one size; values that are not arrays are lists."""


@dataclass(frozen=True)
class Metric:
    """Metric by which the best checkpoint is selected.

    Attributes:
        name: Name of one of the learner's metrics.
        is_error: Whether smaller is better.
    """

    name: str
    is_error: bool

    def is_better(self, value: float, best: float | None) -> bool:
        """Return whether a value is better than the best so far; NaN never is."""
        if not np.isfinite(value):
            return False
        return best is None or (value < best if self.is_error else value > best)


class Task(Protocol):
    """One task: a frozen dataclass whose fields are its settings.

    Attributes:
        kind: Its name on the command line and in checkpoints.
        input_names: Arrays of a sample that are the network's inputs, in this order.
        output_text: Description of the network's output, with unit and shape.
        figure: Metric by which the best checkpoint is selected.
        size: Side of the network's input images [px].
    """

    kind: ClassVar[str]
    input_names: ClassVar[tuple[str, ...]]
    output_text: ClassVar[str]
    figure: ClassVar[Metric]

    @property
    def size(self) -> int:
        """Side of the network's images [px]."""
        ...

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return the indices of the frames of a sequence that can be used for training.

        Raises:
            InputError: If the sequence lacks a required channel.
        """
        ...

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the network's input and the ground truth of one frame.

        Raises:
            InputError: If an image cannot be read.
        """
        ...

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Augment a sample and its labels."""
        ...

    def network(self, *, is_pretrained: bool) -> Any:
        """Create a network (`torch.nn.Module`), with ImageNet weights if requested.

        Raises:
            MissingExtraError: If PyTorch or the weights are not installed.
        """
        ...

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Loss terms of a network on a batch; `loss` is their sum."""
        ...

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Compute metrics over samples, from the network's outputs [c s s] or [c]."""
        ...

    def inputs(self, image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Any) -> Sample:
        """Return the network's input for an image without ground truth.

        Raises:
            InputError: If the network needs the camera and there is none.
        """
        ...

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, ground truth if available, and output side by side, for inspection."""
        ...

    def files(self, output: NDArray, fit: Letterbox) -> Mapping[str, NDArray]:
        """Output images of a prediction by file-name suffix."""
        ...

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """Table columns of a prediction; empty if its files hold everything."""
        ...


@runtime_checkable
class Adversarial(Protocol):
    """Further methods of a learner whose network can be trained against a discriminator.

    The discriminator is trained to distinguish predictions from ground truth. Only training
    checkpoints contain it.
    """

    def adversary(self) -> Any | None:
        """Create a discriminator (`torch.nn.Module`); None if the settings disable it."""
        ...

    def losses(
        self, network: Any, adversary: Any, batch: Batch
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Loss terms of the network and of the discriminator; `loss` is their sum."""
        ...


def flip(sample: Sample, axis: int) -> Sample:
    """Flip all maps of a sample along columns (axis 1) or rows (axis 0)."""
    return _with_maps(sample, lambda array: np.flip(array, axis))


def transposed(sample: Sample) -> Sample:
    """Exchange rows and columns of all maps of a sample."""
    return _with_maps(sample, lambda array: np.swapaxes(array, 0, 1))


def _with_maps(sample: Sample, change: Callable[[NDArray], NDArray]) -> Sample:
    return {
        name: np.array(change(array), order="C") if getattr(array, "ndim", 0) >= 2 else array
        for name, array in sample.items()
    }


def mirrored(sample: Sample, rng: np.random.Generator) -> Sample:
    """Flip a sample along rows, columns, both or neither, at random."""
    for axis in (0, 1):
        if rng.random() < 0.5:
            sample = flip(sample, axis)
    return sample


def zoomed(sample: Sample, rng: np.random.Generator, least: float) -> Sample:
    """Crop a random square from a sample and resize it to the sample's size, as if zoomed.

    Args:
        sample: `image`, and maps [s s ...], which are resampled by nearest neighbor.
        rng: Random generator for the crop.
        least: Minimum side of the crop, relative to the sample's.
    """
    from PIL import Image

    size = sample["image"].shape[0]
    side = size * rng.uniform(least, 1.0)
    left, top = rng.uniform(0.0, size - side, 2)
    middles = (np.arange(size) + 0.5) * side / size
    part = np.ix_((top + middles).astype(int), (left + middles).astype(int))
    image = Image.fromarray(sample["image"])
    box = (left, top, left + side, top + side)
    large = np.asarray(image.resize((size, size), Image.Resampling.BILINEAR, box=box))
    maps = {
        name: np.ascontiguousarray(array[part]) if np.shape(array)[:2] == (size, size) else array
        for name, array in sample.items()
    }
    return maps | {"image": large}


def recolored(
    image: UInt8[np.ndarray, "h w 3"],
    rng: np.random.Generator,
    *,
    exposure: float,
    tint: float,
    gamma: float,
) -> UInt8[np.ndarray, "h w 3"]:
    """Apply random exposure, white balance and gamma, each drawn log-uniformly.

    Args:
        image: Source image.
        rng: Random generator.
        exposure: Maximum factor on all color channels.
        tint: Maximum factor on each color channel.
        gamma: Maximum exponent.
    """
    change = exposure ** rng.uniform(-1.0, 1.0) * tint ** rng.uniform(-1.0, 1.0, 3)
    return with_gain(image, change, gamma ** rng.uniform(-1.0, 1.0))


def with_gain(
    image: UInt8[np.ndarray, "h w 3"], gain: Float[np.ndarray, " 3"], gamma: float
) -> UInt8[np.ndarray, "h w 3"]:
    """Apply a factor per color channel and a gamma to an image."""
    table = np.arange(256)[:, None] / 255.0
    changed = np.clip(255.0 * gain * table**gamma + 0.5, 0, 255).astype(np.uint8)
    return np.stack([changed[image[..., k], k] for k in range(3)], axis=-1)


def outputs_of(network: Any, learner: Task, batch: Batch) -> Any:
    """Output of a network in float32, independent of its compute type."""
    return network(*(batch[name] for name in learner.input_names)).float()
