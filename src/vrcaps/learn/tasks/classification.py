"""Image classification: normal or lesion type."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, cast

import numpy as np
from torch import Tensor, nn

from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.learn.augment import Augmentation, random_flip
from vrcaps.learn.baselines import class_baselines
from vrcaps.learn.networks import Backbone, classifier
from vrcaps.learn.picture_border import Letterbox, Overlay, tissue_mask
from vrcaps.learn.task import MAX_CLASSES, BackboneTask, Batch, Losses, Metric, Presets, Sample
from vrcaps.metrics.labels import accuracy, confusion_matrix, f1_scores, matthews, roc_auc
from vrcaps.recording.frame_sequence import NORMAL, FrameSequence, image_class

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class ClassificationTask(BackboneTask[tuple[np.ndarray, int]]):
    """Image classification: normal or lesion type.

    The label of an image in a folder of classes is the name of its folder. The label of a recorded
    frame is the kind of the lesion with the largest area, if it covers at least `min_fraction` of
    the frame; a frame without any lesion is normal. Frames with less of a lesion, and those with a
    label outside `classes`, are excluded.

    In many real datasets, black corners, inserts and text correlate with the class. Therefore the
    same regions of every image are blackened in training and prediction: those of
    `mask_overlays`.

    Attributes:
        classes: Names of the classes, at least two.
        backbone: Input size and encoder of the network.
        mask_overlays: Hidden regions: `corners` (everything outside an ellipse), `insert` (the
            lower left part), `text` (the left part). Capsules have corners only.
        min_fraction: Minimum fraction of a recorded frame that a lesion must cover to be its label.
        dropout: Fraction of features that are dropped in training.
        augmentation: Random changes of training images.
    """

    classes: tuple[str, ...] = (NORMAL, "polyp", "ulcer")
    backbone: Backbone = field(default_factory=Backbone)
    mask_overlays: tuple[Overlay, ...] = ("corners", "insert")
    min_fraction: Annotated[float, Range(0.0, 1.0)] = 0.005
    dropout: Annotated[float, Range(0.0, below=1.0)] = 0.2
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(1.3, 1.25, 1.3, 0.7))

    kind: ClassVar[str] = "classification"
    pipeline_tag: ClassVar[str] = "image-classification"
    output_text: ClassVar[str] = "logit of each class [b c]"
    presets: ClassVar[Presets] = {
        **BackboneTask.presets,
        # Incetan et al. 2021: ResNet-152 from scratch, 10 epochs of 8,714 images.
        "paper": {
            "task.backbone.encoder": "resnet152",
            "task.backbone.size": 224,
            "start": "scratch",
            "steps": 2723,
            "batch": 32,
            "learning_rate": 1e-3,
        },
    }
    metric: ClassVar[Metric] = Metric("f1", is_error=False)

    def __post_init__(self) -> None:
        check_fields(self)
        is_few = 1 < len(set(self.classes)) <= MAX_CLASSES
        require(is_few, "classes", self.classes[:9], f"2 to {MAX_CLASSES} names")

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return the frames that have one of the classes.

        Raises:
            InputError: If the frames have no labels.
        """
        names = self.prepare(sequence).values["class"]
        return [k for k, name in enumerate(names) if name in self.classes]

    def prepare(self, sequence: FrameSequence) -> FrameSequence:
        """Return the sequence with the labels among its values, so that they are read once.

        Raises:
            InputError: If the frames have no labels.
        """
        if "class" in sequence.values:
            return sequence
        names = np.array([self._class_of(sequence, k) or "" for k in range(len(sequence))])
        return replace(sequence, values={**sequence.values, "class": names})

    def require(self, frames: Sequence[tuple[FrameSequence, int]]) -> None:
        """Check that each class has a training frame.

        Raises:
            InputError: If a class has none.
        """
        counts = Counter(self._class_of(*frame) for frame in frames)
        missing = [name for name in self.classes if not counts[name]]
        if missing:
            present = [name for name in self.classes if counts[name]]
            raise InputError(
                f"No training frame has the class {missing[0]!r}. Frames: "
                f"{', '.join(f'{counts[name]} {name}' for name in present)}. Give more data, or "
                "other --classes."
            )

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the image and the index of its class."""
        image = sequence.image("rgb", index)
        name = self._class_of(sequence, index)
        label = np.asarray(self.classes.index(str(name)))
        letterbox = Letterbox(image.shape[0], image.shape[1], self.input_size)
        return {**self.inputs(image, letterbox, None), "class": label}

    def _class_of(self, sequence: FrameSequence, index: int) -> str | None:
        """Label of a frame; None if it is neither normal nor clearly a lesion."""
        if "class" in sequence.values:
            return str(sequence.values["class"][index])
        if sequence.episode is None:
            raise InputError(
                f"{sequence.name} has no classes. Give a folder with a subfolder for each class."
            )
        if "instance" not in sequence.channels:
            raise InputError(
                f"Training for classification requires the channel 'instance'. {sequence.name} has "
                "none."
            )
        lesions = sequence.episode.head["organ"]["lesions"]
        instance = sequence.image("instance", index)
        seen = np.where(tissue_mask(*instance.shape, self.mask_overlays), instance, 0)
        return image_class(seen, lesions, self.min_fraction)

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], letterbox: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the image with overlays hidden; the camera is not used."""
        square = letterbox.image(image)
        mask = tissue_mask(*letterbox.shape, self.mask_overlays)
        square[letterbox.region] *= mask[..., None]
        return {"image": square}

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips, rotations by 90° and color jitter."""
        sample = random_flip(self.augmentation.crop(sample, rng), rng)
        image = np.rot90(sample["image"], int(rng.integers(4))).copy()
        return sample | {"image": self.augmentation.recolor(image, rng)}

    def network(self, *, is_pretrained: bool) -> nn.Module:
        """Create a network from batches to logits [b c]."""
        return _ClassificationNetwork(
            self.encoder, len(self.classes), is_pretrained=is_pretrained, dropout=self.dropout
        )

    def loss(self, network: nn.Module, batch: Batch) -> Losses:
        """Cross-entropy loss."""
        output = self.output(network, batch)
        return {"loss": nn.functional.cross_entropy(output, batch["class"].long())}

    def terms(self, output: NDArray, sample: Sample) -> tuple[np.ndarray, int]:
        """Logits and true class of one image."""
        return output, int(sample["class"])

    def summary(self, terms: Sequence[tuple[np.ndarray, int]]) -> Mapping[str, float]:
        """Mean F1 of the classes that occur, F1 of each, accuracy, Matthews coefficient and AUC."""
        logits = np.stack([output for output, _ in terms])
        truth = np.array([label for _, label in terms])
        count = len(self.classes)
        confusion = confusion_matrix(logits.argmax(axis=1), truth, count)
        each = f1_scores(confusion)
        occurs = np.bincount(truth, minlength=count) > 0
        probabilities = class_probabilities(logits)
        areas = [roc_auc(probabilities[:, k], truth == k) for k in np.flatnonzero(occurs)]
        return {
            "f1": float(each[occurs].mean()),
            **{f"f1_{name}": float(f1) for name, f1 in zip(self.classes, each, strict=True)},
            "accuracy": accuracy(confusion),
            "mcc": matthews(confusion),
            "auc": float(np.mean(areas)),
        }

    def baselines(
        self, samples: Sequence[Sample], groups: Sequence[str]
    ) -> Mapping[str, Sequence[NDArray]]:
        """The class frequencies, and mean redness or brightness."""
        images = [sample["image"] for sample in samples]
        labels = [int(sample["class"]) for sample in samples]
        return class_baselines(images, labels, len(self.classes))

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image with its true and its predicted class."""
        from PIL import Image, ImageDraw

        text = f"{self.classes[int(output.argmax())]} {class_probabilities(output[None]).max():.2f}"
        if "class" in sample:
            text += f" (is {self.classes[int(sample['class'])]})"
        picture = Image.fromarray(sample["image"])
        ImageDraw.Draw(picture).text((4, 4), text, fill=(255, 255, 255), stroke_width=1)
        return np.asarray(picture)

    def row(self, output: NDArray) -> Mapping[str, object]:
        """The most probable class, and the probability of each class."""
        probabilities = class_probabilities(output[None])[0]
        each = {name: f"{p:.4f}" for name, p in zip(self.classes, probabilities, strict=True)}
        return {"class": self.classes[int(probabilities.argmax())], **each}


def class_probabilities(logits: NDArray) -> NDArray:
    """Probability of each class [n c]: softmax of the logits."""
    from scipy.special import softmax

    return softmax(logits, axis=-1)


class _ClassificationNetwork(nn.Module):
    """Classifier of color images."""

    def __init__(self, encoder: str, classes: int, *, is_pretrained: bool, dropout: float) -> None:
        super().__init__()
        self.net = classifier(encoder, classes, is_pretrained=is_pretrained, dropout=dropout)
        # timm scales the last layer's weights by the number of classes: with few classes they
        # are so large that hundreds of steps are spent on reducing them.
        get_head = cast(Callable[[], nn.Module], self.net.get_classifier)
        for value in get_head().parameters():
            nn.init.zeros_(value)

    def forward(self, image: Tensor) -> Tensor:
        return self.net(2.0 * image - 1.0)
