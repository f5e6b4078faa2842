"""What a learner is: samples of frames, a network, a loss, and scores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

    from vrcaps.learn.fit import Fit

MOST_SIZE = 2048
"""Largest side of a network's images [px]; files of weights may state any."""
MOST_CLASSES = 1000
"""Largest number of classes of a network."""
MOST_WEIGHT = 1e6
"""Largest weight of a term of a loss."""
Sample = dict[str, Any]
"""Arrays of one frame at the network's size; `image` is uint8 [s s 3]. What is no array is for the
loss only."""
INPUTS = {
    "image": "color from 0 to 1, sRGB [b 3 s s]",
    "ray": "unit ray of each pixel in the camera's frame (x right, y down, z forward), zero where "
    "the lens has none [b 3 s s]",
}
"""What networks are given, by the names of their inputs."""
Batch = dict[str, Any]
"""Tensors [b c s s] or [b ...] of samples of one size; lists of what is no array."""


@dataclass(frozen=True)
class Figure:
    """The figure by which weights are chosen.

    Attributes:
        name: One of the learner's scores.
        is_error: Whether smaller is better.
    """

    name: str
    is_error: bool

    def is_better(self, value: float, best: float | None) -> bool:
        """Whether a value is better than the best so far; NaN never is."""
        if not np.isfinite(value):
            return False
        return best is None or (value < best if self.is_error else value > best)


class Learner(Protocol):
    """One task: a frozen dataclass whose fields are its settings.

    Attributes:
        kind: Its name on the command line and in weight files.
        input_names: Arrays of a sample that the network is given, in this order.
        output_text: What the network gives, with unit and shape.
        figure: By which weights are chosen.
        size: Side of the images that the network is given [px].
    """

    kind: ClassVar[str]
    input_names: ClassVar[tuple[str, ...]]
    output_text: ClassVar[str]
    figure: ClassVar[Figure]

    @property
    def size(self) -> int:
        """Side of the network's images [px]."""
        ...

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Numbers of the frames of a sequence that can be learned from.

        Raises:
            InputError: If the sequence lacks a channel that is learned.
        """
        ...

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Network's input and truth of one frame.

        Raises:
            InputError: If an image cannot be read.
        """
        ...

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """The sample changed at random; labels follow."""
        ...

    def network(self, *, is_pretrained: bool) -> Any:
        """A new network (`torch.nn.Module`), on ImageNet weights if so asked.

        Raises:
            MissingExtraError: If PyTorch or the weights are not installed.
        """
        ...

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Terms of the loss of a network on a batch; `loss` is their sum."""
        ...

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Figures over samples, from the network's outputs [c s s] or [c]."""
        ...

    def inputs(self, image: UInt8[np.ndarray, "h w 3"], fit: Fit, camera: Any) -> Sample:
        """Network's input of an image without truth.

        Raises:
            InputError: If the network needs the camera and there is none.
        """
        ...

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, truth if there is one, and output side by side, to look at."""
        ...

    def files(self, output: NDArray, fit: Fit) -> Mapping[str, NDArray]:
        """Images to write of an estimate, by what follows the image's name in theirs."""
        ...

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """What a table says of an estimate; empty if its files say all."""
        ...


@runtime_checkable
class Adversarial(Protocol):
    """What a learner also has whose network can learn against a second one, the adversary.

    The adversary learns to tell outputs from truths. Only checkpoints keep it.
    """

    def adversary(self) -> Any | None:
        """A new adversary (`torch.nn.Module`); None if the settings want none."""
        ...

    def losses(
        self, network: Any, adversary: Any, batch: Batch
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Terms of the loss of the network, and of the adversary's; `loss` is their sum."""
        ...


def flip(sample: Sample, axis: int) -> Sample:
    """All maps of a sample mirrored along columns (axis 1) or rows (axis 0)."""
    return _with_maps(sample, lambda array: np.flip(array, axis))


def transposed(sample: Sample) -> Sample:
    """All maps of a sample with rows and columns exchanged."""
    return _with_maps(sample, lambda array: np.swapaxes(array, 0, 1))


def _with_maps(sample: Sample, change: Callable[[NDArray], NDArray]) -> Sample:
    return {
        name: np.array(change(array), order="C") if getattr(array, "ndim", 0) >= 2 else array
        for name, array in sample.items()
    }


def mirrored(sample: Sample, rng: np.random.Generator) -> Sample:
    """The sample mirrored along rows, columns, both or neither."""
    for axis in (0, 1):
        if rng.random() < 0.5:
            sample = flip(sample, axis)
    return sample


def zoomed(sample: Sample, rng: np.random.Generator, least: float) -> Sample:
    """A random square part of a sample, brought to its size, as another lens would see it.

    Args:
        sample: `image`, and maps [s s ...] of which the nearest values are taken.
        rng: Draws the part.
        least: Smallest side of the part, relative to the sample's.
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
    """The image with random exposure, white balance and gamma, each drawn evenly in its logarithm.

    Args:
        image: To change.
        rng: Draws them.
        exposure: Largest factor on all colors.
        tint: Largest factor on each color.
        gamma: Largest exponent.
    """
    change = exposure ** rng.uniform(-1.0, 1.0) * tint ** rng.uniform(-1.0, 1.0, 3)
    return with_gain(image, change, gamma ** rng.uniform(-1.0, 1.0))


def with_gain(
    image: UInt8[np.ndarray, "h w 3"], gain: Float[np.ndarray, " 3"], gamma: float
) -> UInt8[np.ndarray, "h w 3"]:
    """The image with a factor per color and a gamma about middle brightness."""
    table = np.arange(256)[:, None] / 255.0
    changed = np.clip(255.0 * gain * table**gamma + 0.5, 0, 255).astype(np.uint8)
    return np.stack([changed[image[..., k], k] for k in range(3)], axis=-1)


def outputs_of(network: Any, learner: Learner, batch: Batch) -> Any:
    """Output of a network, in 32 bits, whatever it computed in."""
    return network(*(batch[name] for name in learner.input_names)).float()
