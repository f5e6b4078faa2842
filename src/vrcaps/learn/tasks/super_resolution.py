"""Super-resolution: an image with more pixels than the camera recorded.

Small images are bicubic reductions of large ones, with antialiasing. The network is the small form
of EDSR (Lim et al., CVPR workshops 2017): residual blocks without normalization, then a pixel
shuffle. It predicts the residual to bicubic upsampling. The loss is the mean absolute difference.

With three more terms it is EndoL2H (Almalioglu et al., IEEE TMI 39(12), 2020), a conditional GAN
whose generator is a U-Net with spatial attention::

    loss = |Δ| + adversarial · deceived + content · ‖Δφ‖² + style · ‖ΔGram(φ)‖²

with features φ of a network pre-trained on ImageNet. The output looks sharper but is less accurate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn

from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.learn.augment import random_flip, with_gain
from vrcaps.learn.baselines import upsampling_baselines
from vrcaps.learn.losses import (
    content_loss,
    discriminator_loss,
    feature_distance,
    generator_loss,
    style_loss,
)
from vrcaps.learn.networks import (
    ENCODER,
    MAX_SIZE,
    AttentionUnet,
    PatchDiscriminator,
    feature_network,
)
from vrcaps.learn.perturbation import Degradation, Perturbation
from vrcaps.learn.picture_border import Letterbox
from vrcaps.learn.task import MAX_WEIGHT, Batch, Losses, Metric, Presets, Sample, Task, total
from vrcaps.metrics.images import psnr, ssim
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

_LARGEST = 255.0
_METRICS = ("psnr", "ssim", "feature_distance")


@dataclass(frozen=True)
class SuperResolutionTask(Task[tuple[float, float, float]]):
    """Upsampling of images by a factor of two, four or eight per side.

    Attributes:
        factor: Upsampling factor of each side.
        size: Side of the large training crops [px].
        validation_size: Maximum side of the central part of an image used in validation [px].
        generator: Network: edsr, or attention-unet as in EndoL2H.
        blocks: Number of residual blocks of edsr.
        halvings: Number of levels of attention-unet.
        features: Channels of a block, and of a U-Net's first level.
        adversarial: Weight of the adversarial loss.
        content: Weight of the squared difference of features.
        style: Weight of the squared difference of the features' Gram matrices.
        feature_encoder: Network of these features, by its timm name, such as vgg19; the default's
            weights need no download.
        degradation: Random degradations of the small training images, such as of a recorder.
    """

    factor: Literal[2, 4, 8] = 4
    size: Annotated[int, Range(32, MAX_SIZE)] = 192
    validation_size: Annotated[int, Range(32, 8192)] = 512
    generator: Literal["edsr", "attention-unet"] = "edsr"
    blocks: Annotated[int, Range(1, 128)] = 16
    halvings: Annotated[int, Range(1, 8)] = 5
    features: Annotated[int, Range(8, 1024)] = 64
    adversarial: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.0
    content: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.0
    style: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.0
    feature_encoder: str = ENCODER
    degradation: Degradation = field(default_factory=Degradation)

    kind: ClassVar[str] = "super-resolution"
    pipeline_tag: ClassVar[str] = "image-to-image"
    output_text: ClassVar[str] = "color from 0 to 1 at the larger size [b 3 fs fs]"
    presets: ClassVar[Presets] = {
        "ci": {"task.size": 64},
        # EndoL2H from 256 to 1024 pixels, 100 epochs of 6,400 images. Its published program gives
        # batch size, learning rate and adversarial weight (1 : 100 relative to the absolute
        # difference). It defines content and style losses but never uses them, and the text gives
        # no weights: these make each as large as the adversarial term at the start of training.
        "paper": {
            "task.size": 1024,
            "task.validation_size": 1024,
            "task.generator": "attention-unet",
            "task.halvings": 8,
            "task.adversarial": 0.01,
            "task.content": 3e-4,
            "task.style": 7e-5,
            "start": "scratch",
            "steps": 640_000,
            "batch": 1,
            "learning_rate": 2e-4,
            "weight_decay": 0.0,
        },
    }
    free_axes: ClassVar[Mapping[int, str]] = {0: "batch", 2: "height", 3: "width"}
    metric: ClassVar[Metric] = Metric("psnr", is_error=False)

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def input_size(self) -> int:
        """Side of the network's input images [px]; it takes images of any size."""
        return self.size

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return all frames of a sequence with images.

        Raises:
            InputError: If it has none.
        """
        if "rgb" not in sequence.channels:
            raise InputError(f"Super-resolution requires images. {sequence.name} has none.")
        return range(len(sequence))

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the central part of the image, and a reduced copy.

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

    def perturbed_sample(
        self, sequence: FrameSequence, index: int, perturbation: Perturbation
    ) -> Sample:
        """Return a pair whose small image is perturbed in color; its true image is clean."""
        sample = self.sample(perturbation.framing(sequence), index)
        return sample | {"image": perturbation.recolored(sample["image"], index)}

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips, rotations by 90°, exposure and degradations."""
        truth = sample["truth"]
        top, left = (int(rng.integers(side - self.size + 1)) for side in truth.shape[:2])
        crop = {"truth": truth[top : top + self.size, left : left + self.size]}
        crop = random_flip(crop, rng)
        turned = np.ascontiguousarray(np.rot90(crop["truth"], int(rng.integers(4))))
        gain = 1.2 ** rng.uniform(-1.0, 1.0) * rng.uniform(0.95, 1.05, 3)
        pair = self._pair(with_gain(turned, gain, 1.0))
        return pair | {"image": self.degradation.apply(pair["image"], rng)}

    def _pair(self, truth: UInt8[np.ndarray, "h w 3"]) -> Sample:
        small = _resized(truth, truth.shape[0] // self.factor, truth.shape[1] // self.factor)
        return {"image": small, "truth": truth}

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], letterbox: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the image unchanged; the camera is not used."""
        return {"image": image}

    def network(self, *, is_pretrained: bool) -> nn.Module:
        """Create a network from images [b 3 h w] to [b 3 fh fw], without ImageNet weights."""
        return _SuperResolutionNetwork(self)

    def discriminator(self) -> nn.Module | None:
        """Create a patch discriminator, if the adversarial loss has a weight."""
        return PatchDiscriminator(self.features) if self.adversarial > 0.0 else None

    def loss(self, network: nn.Module, batch: Batch) -> Losses:
        """Mean absolute difference, content and style losses."""
        return total(self._terms(self.output(network, batch), _truth_of(batch)))

    def adversarial_losses(
        self, network: nn.Module, discriminator: nn.Module, batch: Batch
    ) -> tuple[Losses, Losses]:
        """Losses of the network, including the adversarial one, and of the discriminator."""
        small, truth, output = batch["image"], _truth_of(batch), self.output(network, batch)
        adversarial = self.adversarial * generator_loss(discriminator(small, output))
        logits = discriminator(small, truth), discriminator(small, output.detach())
        terms = {**self._terms(output, truth), "adversarial": adversarial}
        return total(terms), {"loss": discriminator_loss(*logits)}

    def _terms(self, output: Tensor, truth: Tensor) -> Losses:
        terms = {"pixel": (output - truth).abs().mean()}
        if self.content > 0.0 or self.style > 0.0:
            maps = feature_network(self.feature_encoder, str(output.device))
            outputs, targets = ([m.float() for m in maps(image)] for image in (output, truth))
            terms["content"] = self.content * content_loss(outputs, targets)
            terms["style"] = self.style * style_loss(outputs, targets)
        return terms

    def terms(self, output: NDArray, sample: Sample) -> tuple[float, float, float]:
        """PSNR [dB], SSIM and feature distance of one 8-bit image."""
        image, truth = image_of(output), sample["truth"]
        within = {"data_range": _LARGEST, "crop": self.factor}
        distance = feature_distance(image, truth, self.feature_encoder)
        return psnr(image, truth, **within), ssim(image, truth, **within), distance

    def summary(self, terms: Sequence[tuple[float, float, float]]) -> Mapping[str, float]:
        """Mean PSNR [dB], SSIM and feature distance of 8-bit images.

        A border of `factor` pixels is excluded. `feature_distance` is that of `losses`,
        with the feature network of the settings.
        """
        return dict(zip(_METRICS, np.mean(terms, axis=0).tolist(), strict=True))

    def baselines(
        self, samples: Sequence[Sample], groups: Sequence[str]
    ) -> Mapping[str, Sequence[NDArray]]:
        """Bicubic and nearest-neighbor upsampling."""
        return upsampling_baselines(samples)

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Central parts of the bicubic upsampling, the output and the ground truth."""
        large = image_of(output)
        images = [_resized(sample["image"], *large.shape[:2]), large]
        images += [sample["truth"]] if "truth" in sample else []
        return np.concatenate([_middle(one, self.size, self.size) for one in images], axis=1)

    def files(self, output: NDArray, letterbox: Letterbox) -> Mapping[str, NDArray]:
        """The upsampled image."""
        return {".png": image_of(output)}


def image_of(output: NDArray) -> UInt8[np.ndarray, "h w 3"]:
    """Image of a network's output [3 h w]."""
    levels = np.clip(np.rint(_LARGEST * np.moveaxis(output, 0, -1)), 0, _LARGEST)
    return np.ascontiguousarray(levels.astype(np.uint8))


def _resized(image: NDArray, height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
    """Bicubic resampling, with antialiasing when it shrinks."""
    from PIL import Image

    resized = Image.fromarray(image).resize((width, height), Image.Resampling.BICUBIC)
    return np.array(resized)


def _middle(image: NDArray, height: int, width: int) -> NDArray:
    """Central part of an image, or all of a smaller one."""
    top = max(0, image.shape[0] - height) // 2
    left = max(0, image.shape[1] - width) // 2
    return np.ascontiguousarray(image[top : top + height, left : left + width])


def _truth_of(batch: Batch) -> Tensor:
    """True images [b 3 h w], 0 to 1."""
    return batch["truth"].float() / _LARGEST


class _ResidualBlock(nn.Module):
    """Two convolutions with a residual connection."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(features, features, 3, padding=1)
        self.second = nn.Conv2d(features, features, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(torch.relu(self.first(x)))


class _SuperResolutionNetwork(nn.Module):
    """Residual to bicubic upsampling, added to it."""

    def __init__(self, task: SuperResolutionTask) -> None:
        super().__init__()
        self.factor, features = task.factor, task.features
        self.head = nn.Conv2d(3, features, 3, padding=1)
        if task.generator == "edsr":
            self.body = nn.Sequential(*(_ResidualBlock(features) for _ in range(task.blocks)))
        else:
            self.body = AttentionUnet(features, task.halvings)
        self.tail = nn.Conv2d(features, 3 * self.factor**2, 3, padding=1)
        nn.init.zeros_(self.tail.weight)  # initially bicubic upsampling
        nn.init.zeros_(self.tail.bias)  # type: ignore[arg-type]

    def forward(self, image: Tensor) -> Tensor:
        features = self.head(2.0 * image - 1.0)
        residual = nn.functional.pixel_shuffle(
            self.tail(features + self.body(features)), self.factor
        )
        large = nn.functional.interpolate(
            image, scale_factor=self.factor, mode="bicubic", align_corners=False
        )
        return large + residual
