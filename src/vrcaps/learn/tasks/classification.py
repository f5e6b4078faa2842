"""Image classification: normal or lesion type."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError, require
from vrcaps.learn.letterbox import Letterbox
from vrcaps.learn.networks import ENCODER, classifier, require_torch
from vrcaps.learn.overlays import Overlay, tissue_mask
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
from vrcaps.metrics.classification import accuracy, confusion_matrix, f1_scores, matthews, roc_auc
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.shown_lesion import NORMAL, shown_lesion

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray


@dataclass(frozen=True)
class ClassificationTask:
    """Classification of images.

    The label of an image in a folder of classes is the name of its folder. The label of a recorded
    frame is the kind of the lesion with the largest area, if it covers at least `min_fraction` of
    the frame; a frame without any lesion is normal. Frames with less of a lesion, and those with a
    label outside `classes`, are excluded.

    In many real datasets, black corners, inserts and text correlate with the class. Therefore the
    same regions of every image are blackened in training and prediction: those of `hides`.

    Attributes:
        classes: Names of the classes, at least two.
        size: Side of the network's input images [px]; maps need a multiple of 32.
        encoder: Name of a timm model, such as resnet152.
        hides: Hidden regions: `corners` (everything outside an ellipse), `insert` (the lower left
            part), `text` (the left part). Capsules have corners only.
        min_fraction: Minimum fraction of a recorded frame that a lesion must cover to be its label.
        dropout: Fraction of features that are dropped in training.
        brightness: Maximum random change of exposure, as a factor: 1.3 is ± 30 %.
        tint: Maximum random change of each color channel, as a factor.
        zoom: Minimum side of a random crop, relative to the image; 1 is the whole image.
    """

    classes: tuple[str, ...] = (NORMAL, "polyp", "ulcer")
    size: Annotated[int, Range(32, MAX_SIZE)] = 192
    encoder: str = ENCODER
    hides: tuple[Overlay, ...] = ("corners", "insert")
    min_fraction: Annotated[float, Range(0.0, 1.0)] = 0.005
    dropout: Annotated[float, Range(0.0, below=1.0)] = 0.2
    brightness: Annotated[float, Range(1.0, 10.0)] = 1.3
    tint: Annotated[float, Range(1.0, 10.0)] = 1.25
    zoom: Annotated[float, Range(above=0.0, max=1.0)] = 0.7

    kind: ClassVar[str] = "classes"
    input_names: ClassVar[tuple[str, ...]] = ("image",)
    output_text: ClassVar[str] = "logit of each class [b c]"
    figure: ClassVar[Metric] = Metric("f1", is_error=False)

    def __post_init__(self) -> None:
        check_fields(self)
        is_few = 1 < len(set(self.classes)) <= MAX_CLASSES
        require(is_few, "classes of images", self.classes[:9], f"2 to {MAX_CLASSES} names")

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return the frames that have one of the classes.

        Raises:
            InputError: If the frames have no labels.
        """
        names = self.with_classes(sequence).values["class"]
        return [k for k, name in enumerate(names) if name in self.classes]

    def with_classes(self, sequence: FrameSequence) -> FrameSequence:
        """Return the sequence with the labels among its values, so that they are read once.

        Raises:
            InputError: If the frames have no labels.
        """
        if "class" in sequence.values:
            return sequence
        names = np.array([self._class_of(sequence, k) or "" for k in range(len(sequence))])
        return replace(sequence, values={**sequence.values, "class": names})

    def require_classes(self, frames: Sequence[tuple[FrameSequence, int]]) -> None:
        """Check that each class has a training frame.

        Raises:
            InputError: If a class has none.
        """
        counts = Counter(self._class_of(*frame) for frame in frames)
        missing = [name for name in self.classes if not counts[name]]
        if missing:
            there = [name for name in self.classes if counts[name]]
            raise InputError(
                f"There is no frame to learn the class {missing[0]!r} from; there are "
                f"{', '.join(f'{counts[name]} {name}' for name in there)}. Give more data, or "
                "other --classes."
            )

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the image and the index of its class."""
        image = sequence.image("rgb", index)
        name = self._class_of(sequence, index)
        number = np.asarray(self.classes.index(str(name)))
        fit = Letterbox(image.shape[0], image.shape[1], self.size)
        return {**self.inputs(image, fit, None), "class": number}

    def _class_of(self, sequence: FrameSequence, index: int) -> str | None:
        """Label of a frame; None if it is neither normal nor clearly a lesion."""
        if "class" in sequence.values:
            return str(sequence.values["class"][index])
        if sequence.episode is None:
            raise InputError(
                f"{sequence.name} has no classes. Give a folder with a folder for each class."
            )
        if "instance" not in sequence.channels:
            raise InputError(
                f"Learning classes needs the channel 'instance', which {sequence.name} has not."
            )
        lesions = sequence.episode.head["organ"]["lesions"]
        instance = sequence.image("instance", index)
        seen = np.where(tissue_mask(*instance.shape, self.hides), instance, 0)
        return shown_lesion(seen, lesions, self.min_fraction)

    def inputs(self, image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Any) -> Sample:
        """Return the image with overlays hidden; the camera is not used."""
        square = fit.image(image)
        square[fit.place] *= tissue_mask(*fit.shape, self.hides)[..., None]
        return {"image": square}

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips, rotations by 90° and color jitter."""
        sample = mirrored(zoomed(sample, rng, self.zoom), rng)
        image = np.rot90(sample["image"], int(rng.integers(4))).copy()
        image = recolored(image, rng, exposure=self.brightness, tint=self.tint, gamma=1.3)
        return sample | {"image": image}

    def network(self, *, is_pretrained: bool) -> Any:
        """Create a network from batches to logits [b c]."""
        return _network_class()(self.encoder, len(self.classes), is_pretrained, self.dropout)

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Cross-entropy loss."""
        torch, output = require_torch(), outputs_of(network, self, batch)
        return {"loss": torch.nn.functional.cross_entropy(output, batch["class"].long())}

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Mean F1 of the classes that occur, F1 of each, accuracy, Matthews coefficient and AUC."""
        logits = np.stack(list(outputs))
        truth = np.array([int(sample["class"]) for sample in samples])
        count = len(self.classes)
        confusion = confusion_matrix(logits.argmax(axis=1), truth, count)
        each = f1_scores(confusion)
        occurs = np.bincount(truth, minlength=count) > 0
        chances = class_probabilities(logits)
        areas = [roc_auc(chances[:, k], truth == k) for k in np.flatnonzero(occurs)]
        return {
            "f1": float(each[occurs].mean()),
            **{f"f1_{name}": float(f1) for name, f1 in zip(self.classes, each, strict=True)},
            "accuracy": accuracy(confusion),
            "mcc": matthews(confusion),
            "auc": float(np.mean(areas)),
        }

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image with its true and its predicted class."""
        from PIL import Image, ImageDraw

        text = f"{self.classes[int(output.argmax())]} {class_probabilities(output[None]).max():.2f}"
        if "class" in sample:
            text += f" (is {self.classes[int(sample['class'])]})"
        shown = Image.fromarray(sample["image"])
        ImageDraw.Draw(shown).text((4, 4), text, fill=(255, 255, 255), stroke_width=1)
        return np.asarray(shown)

    def files(self, output: NDArray, fit: Letterbox) -> Mapping[str, NDArray]:
        """None."""
        return {}

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """The most probable class, and the probability of each class."""
        chances = class_probabilities(output[None])[0]
        each = {name: f"{p:.4f}" for name, p in zip(self.classes, chances, strict=True)}
        return {"class": self.classes[int(chances.argmax())], **each}


def class_probabilities(logits: NDArray) -> NDArray:
    """Probability of each class [n c]: softmax of the logits."""
    from scipy.special import softmax

    return softmax(logits, axis=-1)


def _network_class() -> Any:
    torch = require_torch()

    class ClassNetwork(torch.nn.Module):
        """Classifier of color images."""

        def __init__(self, encoder: str, classes: int, is_pretrained: bool, dropout: float) -> None:
            super().__init__()
            self.net = classifier(encoder, classes, is_pretrained=is_pretrained, dropout=dropout)
            # timm scales the last layer's weights by the number of classes: with few classes they
            # are so large that hundreds of steps are spent on reducing them.
            for value in self.net.get_classifier().parameters():
                torch.nn.init.zeros_(value)

        def forward(self, image: Any) -> Any:
            return self.net(2.0 * image - 1.0)

    return ClassNetwork
