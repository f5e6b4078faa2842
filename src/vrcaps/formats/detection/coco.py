"""COCO: lesion instances with outlines or masks, boxes and areas, for object detection.

One file `annotations/instances_<split>.json` per split, with its images in `<split>/`; images
without lesions are also listed. Boxes are x, y, width, height from the top-left corner of the image
[px]; areas and boxes are computed from the mask. Source: https://cocodataset.org/#format-data.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps import _core
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, UnknownNameError, narrow
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import inside, listed
from vrcaps.formats.detection.masks import mask_of, outlines, run_lengths
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import folder_name
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.recording.frame_files import require_pixels, write_images
from vrcaps.recording.frame_sequence import SPLITS, TIME, FrameSequence

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from jaxtyping import Bool, UInt16
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_OTHER = "lesion"
"""Category of instances of unknown kind."""


@dataclass(frozen=True)
class Coco:
    """COCO: `annotations/instances_<split>.json`, images by split.

    Attributes:
        masks: Encoding of masks: `polygons` along pixel edges, several if a lesion is visible in
            parts; or `rle`, run lengths.
        grades: Whether lesions of different grades are separate categories, such as polyp-Ip.
        crowd: Kinds of lesions marked as crowds, on which detectors are not evaluated, such as
            colitis; their masks are run lengths.
        min_area: Minimum number of pixels of an annotated lesion.
    """

    masks: Literal["polygons", "rle"] = "polygons"
    grades: bool = False
    crowd: tuple[str, ...] = ()
    min_area: Annotated[int, Range(1)] = 1

    kind: ClassVar[str] = "coco"
    needs: ClassVar[Needs] = Needs(channels=("rgb", "instance"), poses=False)

    def __post_init__(self) -> None:
        check_fields(self)
        known = [*_kinds(), _OTHER]
        for name in self.crowd:
            if name not in known:
                raise UnknownNameError("kind of lesion", name, known)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write images, and an annotation file for each split."""
        categories = _categories(sequences, grades=self.grades)
        files: dict[str, _File] = {}
        images = annotations = 0
        for sequence in sequences:
            split = sequence.split or "all"
            root = folder / (sequence.split or "images")
            root.mkdir(exist_ok=True)
            file = files.setdefault(split, _File())
            names = _lesion_names(sequence, grades=self.grades)
            for k in range(len(sequence)):
                images += 1
                name = f"{folder_name(sequence)}_{k:06d}.png"
                write_images([(root / name, sequence.image("rgb", k))])
                instance = sequence.image("instance", k)
                file.images.append(json.dumps(_image(sequence, k, images, name, instance.shape)))
                for row in self._annotations(instance, names, categories):
                    annotations += 1
                    ids = {"id": annotations, "image_id": images}
                    file.annotations.append(json.dumps(ids | row))
                advance()
        (folder / "annotations").mkdir()
        for split, file in files.items():
            path = folder / "annotations" / f"instances_{split}.json"
            write_bytes(path, file.text(categories))

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return frames with lesions as `instance` and categories as `label`.

        External images form one sequence per annotation file.

        Raises:
            InputError: If it is not in this layout.
        """
        files = listed(folder, f"annotations/{_FILES}")
        if not files:
            raise InputError(
                f"{folder} contains no annotations/{_FILES}, so it is not a COCO data set."
            )
        return tuple(sequence for path in files for sequence in _read_file(path, folder))

    def _annotations(
        self,
        instance: UInt16[np.ndarray, "h w"],
        names: dict[int, tuple[str, str]],
        categories: dict[str, int],
    ) -> Iterator[dict[str, Any]]:
        """Annotations of the lesions in an image, without annotation and image IDs."""
        for number in np.unique(instance[instance > 0]).tolist():
            kind, category = names.get(number, (_OTHER, _OTHER))
            mask = instance == number
            area = int(mask.sum())
            if area < self.min_area:
                continue
            is_crowd = kind in self.crowd
            yield {
                "category_id": categories[category],
                "segmentation": _segmentation(mask, as_runs=is_crowd or self.masks == "rle"),
                "area": area,
                "bbox": _box(mask),
                "iscrowd": int(is_crowd),
                "instance": number,
            }


@dataclass
class _File:
    """Rows of an annotation file, as JSON."""

    images: list[str] = field(default_factory=list)
    annotations: list[str] = field(default_factory=list)

    def text(self, categories: dict[str, int]) -> Iterator[bytes]:
        """Yield the file in pieces."""
        info = {"description": f"Made with vrcaps {_core.__version__}"}
        named = [
            {"id": label, "name": name, "supercategory": name.split("-")[0]}
            for name, label in categories.items()
        ]
        yield f'{{"info": {json.dumps(info)},\n"licenses": [],\n'.encode()
        yield f'"categories": {json.dumps(named)},\n'.encode()
        for key, rows, end in (
            ("images", self.images, ",\n"),
            ("annotations", self.annotations, "}\n"),
        ):
            yield f'"{key}": [\n'.encode()
            for index, row in enumerate(rows):
                yield (row + (",\n" if index + 1 < len(rows) else "\n")).encode()
            yield f"]{end}".encode()


def _image(
    sequence: FrameSequence, index: int, image_id: int, name: str, shape: tuple[int, ...]
) -> dict[str, Any]:
    """Row of an image; additional keys, unknown to COCO, give its origin."""
    return {
        "id": image_id,
        "file_name": name,
        "width": shape[1],
        "height": shape[0],
        "sequence": sequence.name,
        "frame": index,
        "time_s": float(sequence.times[index]),
        **({} if sequence.patient is None else {"patient": sequence.patient}),
    }


def _segmentation(mask: Bool[np.ndarray, "h w"], *, as_runs: bool) -> Any:
    if as_runs:
        return run_lengths(mask)
    return [polygon.ravel().tolist() for polygon in outlines(mask)]


def _box(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    x, y = int(columns[0]), int(rows[0])
    return [x, y, int(columns[-1]) - x + 1, int(rows[-1]) - y + 1]


def _kinds() -> list[str]:
    """Kinds of lesions, in a fixed order."""
    from vrcaps.lesion import LESIONS  # slow to load

    return list(LESIONS)


def _lesion_names(sequence: FrameSequence, *, grades: bool) -> dict[int, tuple[str, str]]:
    """Kind and category of each lesion of an episode, by lesion ID."""
    if sequence.episode is None:
        return {}
    names = {}
    for lesion in sequence.episode.head["organ"].get("lesions", []):
        kind, grade = lesion["kind"], lesion.get("grade")
        names[lesion["instance"]] = (kind, f"{kind}-{grade}" if grades and grade else kind)
    return names


def _categories(sequences: Sequence[FrameSequence], *, grades: bool) -> dict[str, int]:
    """Category IDs from 1: all kinds, so that they are the same in every export.

    With grades, the existing ones follow, and `lesion` last, each by name.
    """
    existing = {
        category
        for sequence in sequences
        for _, category in _lesion_names(sequence, grades=grades).values()
    }
    names = [*_kinds(), *sorted(existing - set(_kinds())), _OTHER]
    return {name: number for number, name in enumerate(names, 1)}


_FILES = "instances_*.json"
_CHANNELS = ("rgb", "label", "instance")


def _read_file(path: Path, folder: Path) -> list[FrameSequence]:
    part = path.stem.removeprefix("instances_")
    content = read_plain(path, "annotation")
    try:
        categories = sorted(content["categories"], key=lambda each: each["id"])
        labels = {each["id"]: k for k, each in enumerate(categories, 1)}
        label_names = ("background", *(each["name"] for each in categories))
        annotations: dict[int, list[tuple[int, dict[str, Any]]]] = {}
        for each in content["annotations"]:
            row = (labels[each["category_id"]], each)
            annotations.setdefault(each["image_id"], []).append(row)
        sequences: dict[str, list[dict[str, Any]]] = {}
        for image in content["images"]:
            sequences.setdefault(image.get("sequence", part), []).append(image)
        split = next((name for name in SPLITS if part.startswith(name)), None)
        return [
            FrameSequence(
                name,
                _CHANNELS,
                {TIME: np.array([image.get("time_s", k) for k, image in enumerate(rows)], float)},
                partial(_load, _image_folder(folder, part), rows, annotations),
                label_names=label_names,
                patient=rows[0].get("patient"),
                split=split,
            )
            for name, rows in sequences.items()
        ]
    except (KeyError, TypeError) as error:
        raise InputError(f"{path} contains no COCO instances: {error} is missing.") from error


def _image_folder(folder: Path, part: str) -> Path:
    for root in (folder / part, folder / "images" / part, folder / "images"):
        if root.is_dir():
            return root
    return folder


def _load(
    folder: Path,
    images: Sequence[dict[str, Any]],
    annotations: dict[int, list[tuple[int, dict[str, Any]]]],
    channel: str,
    index: int,
) -> NDArray:
    image = images[index]
    if channel == "rgb":
        return read_rgb(inside(folder, image["file_name"]))
    height, width = int(image["height"]), int(image["width"])
    require_pixels(width, height)
    values = np.zeros((height, width), np.uint8 if channel == "label" else np.uint16)
    rows = list(enumerate(annotations.get(image["id"], []), 1))
    # Single lesions are drawn over crowds.
    for position, (label, row) in sorted(rows, key=lambda each: -each[1][1].get("iscrowd", 0)):
        where = f"annotation {row.get('id')}"
        mask = mask_of(row["segmentation"], height, width, where)
        value = label if channel == "label" else row.get("instance", position)
        values[mask] = narrow([value], values.dtype, f"{channel} values of {folder}")
    return values
