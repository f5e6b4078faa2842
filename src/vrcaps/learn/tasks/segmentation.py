"""Lesion segmentation.

The loss is binary cross-entropy plus one minus the soft Dice coefficient, for each class (Isensee
et al., Nature Methods 18, 2021, use this sum).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError, require
from vrcaps.learn.letterbox import Letterbox, require_size
from vrcaps.learn.networks import ENCODER, dense_network, require_torch
from vrcaps.learn.task import (
    MAX_CLASSES,
    MAX_SIZE,
    Batch,
    Metric,
    Sample,
    mirrored,
    outputs_of,
    recolored,
    zoomed,
)
from vrcaps.lesion.library import LESIONS
from vrcaps.metrics.masks import boundary_f_score, dice, iou
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.shown_lesion import lesion_instances

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

LESION = "lesion"
"""Class of any lesion: any `instance` of a recording, any mask of an image folder."""
_OUTLINE = np.array([60, 220, 90], np.uint8)
_UNKNOWN = 2
"""Label of the padding around the image, which is neither inside nor outside a mask."""


@dataclass(frozen=True)
class SegmentationTask:
    """Segmentation of lesions, with one mask per class; masks may overlap.

    Attributes:
        classes: `lesion` for any lesion, kinds of lesions of a recording such as `polyp`, or names
            of labels.
        size: Side of the network's input images [px]; maps need a multiple of 32.
        encoder: Name of a timm model, such as resnet152.
        brightness: Maximum random change of exposure, as a factor: 1.3 is ± 30 %.
        tint: Maximum random change of each color channel, as a factor.
        zoom: Minimum side of a random crop, relative to the image; 1 is the whole image.
    """

    classes: tuple[str, ...] = (LESION,)
    size: Annotated[int, Range(32, MAX_SIZE)] = 192
    encoder: str = ENCODER
    brightness: Annotated[float, Range(1.0, 10.0)] = 1.3
    tint: Annotated[float, Range(1.0, 10.0)] = 1.25
    zoom: Annotated[float, Range(above=0.0, max=1.0)] = 0.6

    kind: ClassVar[str] = "masks"
    input_names: ClassVar[tuple[str, ...]] = ("image",)
    output_text: ClassVar[str] = "logit of each class in each pixel, above 0 inside [b c s s]"
    figure: ClassVar[Metric] = Metric("dice", is_error=False)

    def __post_init__(self) -> None:
        check_fields(self)
        require_size(self.size)
        is_few = 0 < len(self.classes) <= MAX_CLASSES
        require(is_few, "number of classes of masks", len(self.classes), f"1 to {MAX_CLASSES}")

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return all frames of a sequence with images and masks.

        Raises:
            InputError: If it has no masks, or lacks a class.
        """
        for name in self.classes:
            channel = _channel_of(sequence, name)
            for needed in ("rgb", channel):
                if needed not in sequence.channels:
                    raise InputError(
                        f"Learning masks needs the channel {needed!r}, which {sequence.name} has "
                        "not: images without masks."
                    )
            if channel == "label" and name not in (LESION, *sequence.label_names):
                known = ", ".join(sequence.label_names[1:])
                raise InputError(
                    f"{sequence.name} has no class {name!r}. It has: {known}; {LESION!r} is any."
                )
        return range(len(sequence))

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the image and its masks [s s c]: 0, 1, or 2 in the padding."""
        image = sequence.image("rgb", index)
        fit = Letterbox(image.shape[0], image.shape[1], self.size)
        masks = [self._mask(sequence, index, name) for name in self.classes]
        for mask in masks:
            if mask.shape != image.shape[:2]:
                raise InputError(
                    f"Frame {index} of {sequence.name} has an image of {image.shape[:2]} and a "
                    f"mask of {mask.shape} pixels. Allowed: one size."
                )
        truth = fit.nearest(np.stack(masks, axis=-1).astype(np.uint8), _UNKNOWN)
        return {**self.inputs(image, fit, None), "mask": truth}

    def _mask(self, sequence: FrameSequence, index: int, name: str) -> NDArray:
        shown = sequence.image(_channel_of(sequence, name), index)
        if name == LESION:
            return (shown if sequence.episode is None else lesion_instances(shown)) > 0
        if name in _kinds(sequence):
            return np.isin(shown, _kinds(sequence)[name])
        return shown == sequence.label_names.index(name)

    def inputs(self, image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Any) -> Sample:
        """Return the image; the camera is not used."""
        return {"image": fit.image(image)}

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips, a transposition and color jitter."""
        sample = mirrored(zoomed(sample, rng, self.zoom), rng)
        if rng.random() < 0.5:
            sample = {name: np.swapaxes(array, 0, 1).copy() for name, array in sample.items()}
        image = recolored(sample["image"], rng, exposure=self.brightness, tint=self.tint, gamma=1.3)
        return sample | {"image": image}

    def network(self, *, is_pretrained: bool) -> Any:
        """Create a network from batches to logits [b c s s]."""
        return _network_class()(self.encoder, len(self.classes), is_pretrained)

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Cross-entropy and Dice over the pixels of the images."""
        return self.output_loss(outputs_of(network, self, batch), batch)

    def output_loss(self, output: Any, batch: Batch) -> dict[str, Any]:
        """Loss terms of an output [b c s s]."""
        torch = require_torch()
        truth = batch["mask"]
        known = (truth != _UNKNOWN).float()
        target = (truth == 1).float()
        entropy = torch.nn.functional.binary_cross_entropy_with_logits(
            output, target, reduction="none"
        )
        chance = torch.sigmoid(output) * known
        both = (chance * target).sum(dim=(2, 3))
        total = (chance + target * known).sum(dim=(2, 3))
        terms = {
            "entropy": (entropy * known).sum() / known.sum().clamp(min=1),
            "dice": (1.0 - (2.0 * both + 1.0) / (total + 1.0)).mean(),
        }
        return {**terms, "loss": sum(terms.values())}

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Means over images and classes; images without a lesion count in `specificity` only.

        `specificity` is the fraction of lesion-free masks with an empty prediction.
        """
        found: dict[str, list[float]] = {"dice": [], "iou": [], "boundary_f": [], "specificity": []}
        for output, sample in zip(outputs, samples, strict=True):
            for number in range(len(self.classes)):
                mask = sample["mask"][..., number]
                truth, estimate = mask == 1, (output[number] > 0.0) & (mask != _UNKNOWN)
                if not truth.any():
                    found["specificity"].append(float(not estimate.any()))
                    continue
                found["dice"].append(dice(estimate, truth))
                found["iou"].append(iou(estimate, truth))
                found["boundary_f"].append(boundary_f_score(estimate, truth))
        return {k: float(np.mean(v)) if v else float("nan") for k, v in found.items()}

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image with the outlines of the true and of the predicted masks."""
        masks = [output.max(axis=0) > 0.0]
        if "mask" in sample:
            masks.insert(0, (sample["mask"] == 1).any(axis=-1))
        return np.concatenate([_outlined(sample["image"], mask) for mask in masks], axis=1)

    def files(self, output: NDArray, fit: Letterbox) -> Mapping[str, NDArray]:
        """A mask for each class: 255 inside."""
        masks = (np.where(fit.back(logits) > 0.0, 255, 0).astype(np.uint8) for logits in output)
        return {f"_{name}.png": mask for name, mask in zip(self.classes, masks, strict=True)}

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """Return no columns."""
        return {}


def _channel_of(sequence: FrameSequence, name: str) -> str:
    """Channel that holds the masks of a class."""
    is_instance = "instance" in sequence.channels and (name == LESION or name in _kinds(sequence))
    return "instance" if is_instance else "label"


def _kinds(sequence: FrameSequence) -> dict[str, list[int]]:
    """Instances of each kind of lesion in a recording; empty for other data."""
    if sequence.episode is None:
        return {}
    lesions = sequence.episode.head["organ"]["lesions"]
    return {kind: [one["instance"] for one in lesions if one["kind"] == kind] for kind in LESIONS}


def _outlined(image: NDArray, mask: NDArray) -> NDArray:
    from scipy.ndimage import binary_dilation

    line = binary_dilation(mask, iterations=2) & ~mask
    return np.where(line[..., None], _OUTLINE, image)


def _network_class() -> Any:
    torch = require_torch()

    class MaskNetwork(torch.nn.Module):
        """U-Net on color."""

        def __init__(self, encoder: str, classes: int, is_pretrained: bool) -> None:
            super().__init__()
            self.net = dense_network(encoder, 3, classes, is_pretrained=is_pretrained)

        def forward(self, image: Any) -> Any:
            return self.net(2.0 * image - 1.0)

    return MaskNetwork
