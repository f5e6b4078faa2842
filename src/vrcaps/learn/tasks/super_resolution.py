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

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.learn.adversary import deceiving_loss, discriminating_loss, patch_discriminator
from vrcaps.learn.attention_unet import attention_unet
from vrcaps.learn.feature_losses import content_loss, feature_distance, style_loss
from vrcaps.learn.letterbox import Letterbox
from vrcaps.learn.networks import ENCODER, feature_network, require_torch
from vrcaps.learn.task import (
    MAX_SIZE,
    MAX_WEIGHT,
    Batch,
    Metric,
    Sample,
    mirrored,
    outputs_of,
    with_gain,
)
from vrcaps.metrics.images import psnr, ssim
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

_LARGEST = 255.0
_MEASURES = ("psnr", "ssim", "feature_distance")


@dataclass(frozen=True)
class SuperResolutionTask:
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
            weights need no hub.
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

    kind: ClassVar[str] = "super-resolution"
    input_names: ClassVar[tuple[str, ...]] = ("image",)
    output_text: ClassVar[str] = "color from 0 to 1 at the larger size [b 3 fs fs]"
    figure: ClassVar[Metric] = Metric("psnr", is_error=False)

    def __post_init__(self) -> None:
        check_fields(self)

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return all frames of a sequence with images.

        Raises:
            InputError: If it has none.
        """
        if "rgb" not in sequence.channels:
            raise InputError(f"Super-resolution needs images, which {sequence.name} has not.")
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

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips, rotations by 90° and exposure."""
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

    def inputs(self, image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Any) -> Sample:
        """Return the image unchanged; the camera is not used."""
        return {"image": image}

    def network(self, *, is_pretrained: bool) -> Any:
        """Create a network from images [b 3 h w] to [b 3 fh fw], without ImageNet weights."""
        if self.generator == "edsr":
            body = partial(_residual_blocks, self.blocks, self.features)
        else:
            body = partial(attention_unet, self.features, self.halvings)
        return _network_class()(self.factor, body, self.features)

    def adversary(self) -> Any | None:
        """Create a patch discriminator, if the adversarial loss has a weight."""
        return patch_discriminator(self.features) if self.adversarial > 0.0 else None

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Mean absolute difference, content and style losses."""
        return _summed(self._terms(outputs_of(network, self, batch), _truth_of(batch)))

    def losses(
        self, network: Any, adversary: Any, batch: Batch
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Losses of the network, including the adversarial one, and of the discriminator."""
        small, truth, output = batch["image"], _truth_of(batch), outputs_of(network, self, batch)
        deceived = self.adversarial * deceiving_loss(adversary(small, output))
        judged = adversary(small, truth), adversary(small, output.detach())
        terms = {**self._terms(output, truth), "adversarial": deceived}
        return _summed(terms), {"loss": discriminating_loss(*judged)}

    def _terms(self, output: Any, truth: Any) -> dict[str, Any]:
        terms = {"pixel": (output - truth).abs().mean()}
        if self.content > 0.0 or self.style > 0.0:
            maps = feature_network(self.feature_encoder, str(output.device))
            found, wanted = ([m.float() for m in maps(image)] for image in (output, truth))
            terms["content"] = self.content * content_loss(found, wanted)
            terms["style"] = self.style * style_loss(found, wanted)
        return terms

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """PSNR [dB] and SSIM of 8-bit images, also for bicubic upsampling.

        A border of `factor` pixels is excluded. `feature_distance` is that of `feature_losses`,
        with the feature network of the settings.
        """
        rows = []
        distance = partial(feature_distance, encoder=self.feature_encoder)
        within = {"data_range": _LARGEST, "crop": self.factor}
        measures = (partial(psnr, **within), partial(ssim, **within), distance)
        for output, sample in zip(outputs, samples, strict=True):
            truth = sample["truth"]
            bicubic = _resized(sample["image"], *truth.shape[:2])
            rows.append(
                [
                    measure(image, truth)
                    for image in (image_of(output), bicubic)
                    for measure in measures
                ]
            )
        names = [f"{n}{of}" for of in ("", "_bicubic") for n in _MEASURES]
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Central parts of the bicubic upsampling, the output and the ground truth."""
        large = image_of(output)
        shown = [_resized(sample["image"], *large.shape[:2]), large]
        shown += [sample["truth"]] if "truth" in sample else []
        return np.concatenate([_middle(one, self.size, self.size) for one in shown], axis=1)

    def files(self, output: NDArray, fit: Letterbox) -> Mapping[str, NDArray]:
        """The upsampled image."""
        return {".png": image_of(output)}

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """Return no columns."""
        return {}


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


def _truth_of(batch: Batch) -> Any:
    """True images [b 3 h w], 0 to 1."""
    return batch["truth"].float() / _LARGEST


def _summed(terms: dict[str, Any]) -> dict[str, Any]:
    return {**terms, "loss": sum(terms.values())}


def _residual_blocks(count: int, features: int) -> Any:
    torch = require_torch()
    nn = torch.nn

    class Block(nn.Module):
        """Two convolutions with a residual connection."""

        def __init__(self, features: int) -> None:
            super().__init__()
            self.first = nn.Conv2d(features, features, 3, padding=1)
            self.second = nn.Conv2d(features, features, 3, padding=1)

        def forward(self, x: Any) -> Any:
            return x + self.second(torch.relu(self.first(x)))

    return nn.Sequential(*(Block(features) for _ in range(count)))


def _network_class() -> Any:
    nn = require_torch().nn

    class SuperResolutionNetwork(nn.Module):
        """Residual to bicubic upsampling, added to it."""

        def __init__(self, factor: int, body: Callable[[], Any], features: int) -> None:
            super().__init__()
            self.factor = factor
            self.head = nn.Conv2d(3, features, 3, padding=1)
            self.body = body()
            self.tail = nn.Conv2d(features, 3 * factor**2, 3, padding=1)
            nn.init.zeros_(self.tail.weight)  # initially bicubic upsampling
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
