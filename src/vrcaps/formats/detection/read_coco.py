"""Reader of COCO instances from any source."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, narrow
from vrcaps.core.names import inside, listed
from vrcaps.formats.detection.masks import mask_of
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.recording.frame_files import require_pixels
from vrcaps.recording.frame_sequence import SPLITS, TIME, FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FILES = "instances_*.json"
_CHANNELS = ("rgb", "label", "instance")


def read_coco(folder: Path) -> tuple[FrameSequence, ...]:
    """Return the sequences of a folder with `annotations/instances_*.json`, see `Coco.read`.

    Raises:
        InputError: If there is no such file, or one cannot be read.
    """
    files = listed(folder, f"annotations/{_FILES}")
    if not files:
        raise InputError(f"{folder} holds no annotations/{_FILES}, so it is no COCO data set.")
    return tuple(sequence for path in files for sequence in _read_file(path, folder))


def _read_file(path: Path, folder: Path) -> list[FrameSequence]:
    part = path.stem.removeprefix("instances_")
    content = read_plain(path, "annotation")
    try:
        categories = sorted(content["categories"], key=lambda each: each["id"])
        number = {each["id"]: k for k, each in enumerate(categories, 1)}
        label_names = ("background", *(each["name"] for each in categories))
        annotations: dict[int, list[tuple[int, dict[str, Any]]]] = {}
        for each in content["annotations"]:
            row = (number[each["category_id"]], each)
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
        raise InputError(f"{path} holds no COCO instances: {error} is missing.") from error


def _image_folder(folder: Path, part: str) -> Path:
    for place in (folder / part, folder / "images" / part, folder / "images"):
        if place.is_dir():
            return place
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
    for place, (label, row) in sorted(rows, key=lambda each: -each[1][1].get("iscrowd", 0)):
        where = f"annotation {row.get('id')}"
        mask = mask_of(row["segmentation"], height, width, where)
        number = label if channel == "label" else row.get("instance", place)
        values[mask] = narrow([number], values.dtype, f"{channel} numbers of {folder}")
    return values
