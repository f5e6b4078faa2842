"""Lesion segmentation.

The loss is binary cross-entropy plus one minus the soft Dice coefficient, for each class (Isensee
et al., Nature Methods 18, 2021, use this sum).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import check_fields
from vrcaps.learn.augment import Augmentation, random_flip, transpose
from vrcaps.learn.baselines import mask_baselines
from vrcaps.learn.networks import Backbone, OrientedUNet
from vrcaps.learn.picture_border import Letterbox
from vrcaps.learn.task import MAX_CLASSES, BackboneTask, Batch, Losses, Metric, Sample, total
from vrcaps.lesion.library import LESIONS
from vrcaps.metrics.labels import boundary_f_score, dice, iou
from vrcaps.recording.frame_sequence import FrameSequence, lesion_instances

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

LESION = "lesion"
"""Class of any lesion: any `instance` of a recording, any mask of an image folder."""
Scores: TypeAlias = list[dict[str, float]]
"""Metrics of one image by name, for each class."""
_OUTLINE = np.array([60, 220, 90], np.uint8)
_METRICS = ("dice", "iou", "boundary_f", "specificity")
_UNKNOWN = 2
"""Label of the padding around the image, which is neither inside nor outside a mask."""


@dataclass(frozen=True)
class SegmentationTask(BackboneTask[Scores]):
    """Lesion segmentation, with one mask per class; masks may overlap.

    Attributes:
        classes: `lesion` for any lesion, kinds of lesions of a recording such as `polyp`, or names
            of labels.
        backbone: Input size and encoder of the network.
        mirroring: Whether a prediction is the mean over the eight orientations of an image: its
            mirror images and their transpositions (test-time augmentation). It takes eight times as
            long.
        augmentation: Random changes of training images.
    """

    classes: tuple[str, ...] = (LESION,)
    backbone: Backbone = field(default_factory=Backbone)
    mirroring: bool = False
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(1.3, 1.25, 1.3, 0.6))

    kind: ClassVar[str] = "segmentation"
    pipeline_tag: ClassVar[str] = "image-segmentation"
    output_text: ClassVar[str] = "logit of each class in each pixel, above 0 inside [b c s s]"
    metric: ClassVar[Metric] = Metric("dice", is_error=False)
    fallback_class: ClassVar[str] = LESION

    def __post_init__(self) -> None:
        check_fields(self)
        self.backbone.require_stride()
        is_few = 0 < len(self.classes) <= MAX_CLASSES
        require(is_few, "number of classes", len(self.classes), f"1 to {MAX_CLASSES}")

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
                        f"Training for segmentation requires the channel {needed!r}. "
                        f"{sequence.name} has none: its images have no masks."
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
        letterbox = Letterbox(image.shape[0], image.shape[1], self.input_size)
        masks = [self._mask(sequence, index, name) for name in self.classes]
        for mask in masks:
            if mask.shape != image.shape[:2]:
                raise InputError(
                    f"Frame {index} of {sequence.name} has an image of {image.shape[:2]} and a "
                    f"mask of {mask.shape} pixels. Allowed: one size."
                )
        truth = letterbox.nearest(np.stack(masks, axis=-1).astype(np.uint8), _UNKNOWN)
        return {**self.inputs(image, letterbox, None), "mask": truth}

    def _mask(self, sequence: FrameSequence, index: int, name: str) -> NDArray:
        labels = sequence.image(_channel_of(sequence, name), index)
        if name == LESION:
            return (labels if sequence.episode is None else lesion_instances(labels)) > 0
        if name in _kinds(sequence):
            return np.isin(labels, _kinds(sequence)[name])
        return labels == sequence.label_names.index(name)

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips, a transposition and color jitter."""
        sample = random_flip(self.augmentation.crop(sample, rng), rng)
        if rng.random() < 0.5:
            sample = transpose(sample)
        return sample | {"image": self.augmentation.recolor(sample["image"], rng)}

    def network(self, *, is_pretrained: bool) -> nn.Module:
        """Create a network from batches to logits [b c s s]."""
        return OrientedUNet(
            self.backbone,
            len(self.classes),
            is_pretrained=is_pretrained,
            mirroring=self.mirroring,
        )

    def loss(self, network: nn.Module, batch: Batch) -> Losses:
        """Cross-entropy and Dice over the pixels of the images."""
        return segmentation_loss(self.output(network, batch), batch["mask"])

    def terms(self, output: NDArray, sample: Sample) -> Scores:
        """Metrics of each class of one image."""
        values: Scores = []
        for index in range(len(self.classes)):
            mask = sample["mask"][..., index]
            truth, estimate = mask == 1, (output[index] > 0.0) & (mask != _UNKNOWN)
            if not truth.any():
                values.append({"specificity": float(not estimate.any())})
                continue
            scores = dice(estimate, truth), iou(estimate, truth), boundary_f_score(estimate, truth)
            values.append(dict(zip(("dice", "iou", "boundary_f"), scores, strict=True)))
        return values

    def summary(self, terms: Sequence[Scores]) -> Mapping[str, float]:
        """Means over images and classes; images without a lesion count in `specificity` only.

        `specificity` is the fraction of lesion-free masks with an empty prediction.
        """
        scores: dict[str, list[float]] = {name: [] for name in _METRICS}
        for name, value in (pair for one in terms for scores in one for pair in scores.items()):
            scores[name].append(value)
        return {k: float(np.mean(v)) if v else float("nan") for k, v in scores.items()}

    def baselines(
        self, samples: Sequence[Sample], groups: Sequence[str]
    ) -> Mapping[str, Sequence[NDArray]]:
        """Nothing, the whole image, a centered disc and a redness threshold, for each class."""
        images = [sample["image"] for sample in samples]
        each = [
            mask_baselines(images, [sample["mask"][..., index] == 1 for sample in samples])
            for index in range(len(self.classes))
        ]
        return {
            name: [
                np.where(np.stack(masks), 1.0, -1.0)
                for masks in zip(*(one[name] for one in each), strict=True)
            ]
            for name in each[0]
        }

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image with the outlines of the true and of the predicted masks."""
        masks = [output.max(axis=0) > 0.0]
        if "mask" in sample:
            masks.insert(0, (sample["mask"] == 1).any(axis=-1))
        return np.concatenate([_outlined(sample["image"], mask) for mask in masks], axis=1)

    def files(self, output: NDArray, letterbox: Letterbox) -> Mapping[str, NDArray]:
        """A mask for each class: 255 inside."""
        logits = (letterbox.back(one) for one in output)
        masks = (np.where(one > 0.0, 255, 0).astype(np.uint8) for one in logits)
        return {f"_{name}.png": mask for name, mask in zip(self.classes, masks, strict=True)}


def segmentation_loss(output: Tensor, mask: Tensor) -> Losses:
    """Loss terms of an output [b c s s] with true masks: 0, 1, or 2 in the padding."""
    known = (mask != _UNKNOWN).float()
    target = (mask == 1).float()
    entropy = nn.functional.binary_cross_entropy_with_logits(output, target, reduction="none")
    probability = torch.sigmoid(output) * known
    both = (probability * target).sum(dim=(2, 3))
    area = (probability + target * known).sum(dim=(2, 3))
    return total(
        {
            "entropy": (entropy * known).sum() / known.sum().clamp(min=1),
            "dice": (1.0 - (2.0 * both + 1.0) / (area + 1.0)).mean(),
        }
    )


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
