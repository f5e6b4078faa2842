"""Super-resolution: an image with more pixels than was taken.

Small images are made of large ones by averaging bicubic reduction. The network is EDSR (Lim et al.,
CVPR workshops 2017) in its small form: residual blocks without normalization, then a pixel shuffle;
it learns what is to be added to bicubic enlargement. The loss is the mean absolute difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.errors import InputError
from vrcaps.learn.fit import Fit
from vrcaps.learn.learner import Batch, Figure, Sample, mirrored, outputs_of, with_gain
from vrcaps.learn.networks import require_torch
from vrcaps.limits import Range, check_fields
from vrcaps.metrics.image_quality import psnr, ssim
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

_LARGEST = 255.0


@dataclass(frozen=True)
class SuperResolutionLearner:
    """Images of twice or four times the side.

    Attributes:
        factor: By which the side grows.
        size: Side of the large crops that are learned from [px].
        validation_size: Largest side of the middle of an image that is validated with [px].
        blocks: Number of residual blocks.
        features: Channels of a block.
    """

    factor: Literal[2, 4] = 4
    size: Annotated[int, Range(32)] = 192
    validation_size: Annotated[int, Range(32)] = 512
    blocks: Annotated[int, Range(1)] = 16
    features: Annotated[int, Range(8)] = 64

    kind: ClassVar[str] = "super-resolution"
    input_names: ClassVar[tuple[str, ...]] = ("image",)
    figure: ClassVar[Figure] = Figure("psnr", is_error=False)

    def __post_init__(self) -> None:
        check_fields(self)

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """All frames of a sequence with images.

        Raises:
            InputError: If it has none.
        """
        if "rgb" not in sequence.channels:
            raise InputError(f"Super-resolution needs images, which {sequence.name} has not.")
        return range(len(sequence))

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """The middle of the image, and the same made small.

        Raises:
            InputError: If the image is smaller than the crops.
        """
        image = sequence.image("rgb", index)
        if min(image.shape[:2]) < self.size:
            raise InputError(
                f"Frame {index} of {sequence.name} has {image.shape[1]} x {image.shape[0]} pixels. "
                f"Allowed: {self.size} or more (--size)."
            )
        sides = (
            min(side, self.validation_size) // self.factor * self.factor for side in image.shape[:2]
        )
        return self._pair(_middle(image, *sides))

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """A crop at a random place, mirrored or turned, with another exposure."""
        truth = sample["truth"]
        top, left = (int(rng.integers(side - self.size + 1)) for side in truth.shape[:2])
        crop = {"truth": truth[top : top + self.size, left : left + self.size]}
        crop = mirrored(crop, rng)
        turned = np.ascontiguousarray(np.rot90(crop["truth"], int(rng.integers(4))))
        gain = 1.2 ** rng.uniform(-1.0, 1.0) * rng.uniform(0.95, 1.05, 3)
        return self._pair(with_gain(turned, gain, 1.0))

    def _pair(self, truth: UInt8[np.ndarray, "h w 3"]) -> Sample:
        small = _resized(truth, truth.shape[0] // self.factor, truth.shape[1] // self.factor)
        return {"image": small, "truth": truth}

    def inputs(self, image: UInt8[np.ndarray, "h w 3"], fit: Fit, camera: Any) -> Sample:
        """The image as it is; any camera will do."""
        return {"image": image}

    def network(self, *, is_pretrained: bool) -> Any:
        """A network from images [b 3 h w] to images [b 3 fh fw]; it has no ImageNet weights."""
        return _network_class()(self.factor, self.blocks, self.features)

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Mean absolute difference."""
        output = outputs_of(network, self, batch)
        return {"loss": (output - batch["truth"].float() / _LARGEST).abs().mean()}

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """PSNR [dB] and SSIM of 8-bit images without a border of `factor`, and bicubic's."""
        rows = []
        for output, sample in zip(outputs, samples, strict=True):
            truth = sample["truth"]
            bicubic = _resized(sample["image"], *truth.shape[:2])
            rows.append(
                [
                    measure(image, truth, data_range=_LARGEST, crop=self.factor)
                    for image in (image_of(output), bicubic)
                    for measure in (psnr, ssim)
                ]
            )
        names = ("psnr", "ssim", "psnr_bicubic", "ssim_bicubic")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """The middle of bicubic enlargement, of the output, and of the original."""
        large = image_of(output)
        shown = [_resized(sample["image"], *large.shape[:2]), large]
        shown += [sample["truth"]] if "truth" in sample else []
        return np.concatenate([_middle(one, self.size, self.size) for one in shown], axis=1)

    def files(self, output: NDArray, fit: Fit) -> Mapping[str, NDArray]:
        """The large image."""
        return {".png": image_of(output)}

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """Nothing."""
        return {}


def image_of(output: NDArray) -> UInt8[np.ndarray, "h w 3"]:
    """The image of a network's output [3 h w]."""
    levels = np.clip(np.rint(_LARGEST * np.moveaxis(output, 0, -1)), 0, _LARGEST)
    return np.ascontiguousarray(levels.astype(np.uint8))


def _resized(image: NDArray, height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
    """Bicubic, averaging where it shrinks."""
    from PIL import Image

    resized = Image.fromarray(image).resize((width, height), Image.Resampling.BICUBIC)
    return np.array(resized)


def _middle(image: NDArray, height: int, width: int) -> NDArray:
    """The middle of an image, or all of a smaller one."""
    top = max(0, image.shape[0] - height) // 2
    left = max(0, image.shape[1] - width) // 2
    return np.ascontiguousarray(image[top : top + height, left : left + width])


def _network_class() -> Any:
    torch = require_torch()
    nn = torch.nn

    class Block(nn.Module):
        """Two convolutions added to their input."""

        def __init__(self, features: int) -> None:
            super().__init__()
            self.first = nn.Conv2d(features, features, 3, padding=1)
            self.second = nn.Conv2d(features, features, 3, padding=1)

        def forward(self, x: Any) -> Any:
            return x + self.second(torch.relu(self.first(x)))

    class SuperResolutionNetwork(nn.Module):
        """What is to be added to bicubic enlargement."""

        def __init__(self, factor: int, blocks: int, features: int) -> None:
            super().__init__()
            self.factor = factor
            self.head = nn.Conv2d(3, features, 3, padding=1)
            self.body = nn.Sequential(*(Block(features) for _ in range(blocks)))
            self.tail = nn.Conv2d(features, 3 * factor**2, 3, padding=1)
            nn.init.zeros_(self.tail.weight)  # begins as bicubic enlargement
            nn.init.zeros_(self.tail.bias)

        def forward(self, image: Any) -> Any:
            features = self.head(2.0 * image - 1.0)
            added = nn.functional.pixel_shuffle(
                self.tail(features + self.body(features)), self.factor
            )
            large = nn.functional.interpolate(
                image, scale_factor=self.factor, mode="bicubic", align_corners=False
            )
            return large + added

    return SuperResolutionNetwork
