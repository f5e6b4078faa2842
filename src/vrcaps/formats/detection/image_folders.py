"""Image folders: one per class, or images with masks in a neighboring folder; of any sizes.

Masks lie in a folder next to that of their images, under the same names: ``masks`` or ``mask``
next to ``images`` or ``image``, as in Kvasir-SEG and BKAI-IGH NeoPolyp, or ``bleeding_mask``
next to ``bleeding``, as in WCEBleedGen. A mask holds 255 (or its JPEG approximation) for
lesions, or class indices. Other folders of images are classes, as in HyperKvasir, Kvasir-Capsule.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.core.errors import InputError, narrow
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import inside, listed
from vrcaps.formats.format import Needs, require_channels
from vrcaps.formats.shared.folders import folder_name, image_loader
from vrcaps.formats.shared.stored_images import IMAGES, read_plane, read_rgb
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import (
    SPLITS,
    TIME,
    FrameSequence,
    image_class,
    lesion_instances,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

FILE_NAME = "file_name"
"""Name of the value with an image's file name without its extension."""

_IMAGES, _MASKS = ("images", "image"), ("masks", "mask")
_CLASSES = "classes.txt"
_JPEG = (".jpg", ".jpeg")
_DIGITS = re.compile(r"(\d+)")

Masks = Literal["auto", "binary", "numbers"]


@dataclass(frozen=True)
class Images:
    """Image folders: one per class, or images with masks in a neighboring folder.

    Attributes:
        layout: Layout on writing: `masks` (`images/`, `masks/`), or `classes`, a folder per kind of
            the largest lesion in an image, and `normal`.
        masks: Mask values: `binary` is 255 for lesions, `numbers` class indices. `auto` writes
            lesions if instances were recorded and labels otherwise, and reads masks with values
            above 127, and JPEG, as binary.
        min_fraction: Minimum fraction of an image that a lesion must cover to determine its class;
            images with smaller lesions are left out.
        fps: Frames per second on reading; such folders have no times.
    """

    layout: Literal["masks", "classes"] = "masks"
    masks: Masks = "auto"
    min_fraction: Annotated[float, Range(0.0, 1.0)] = 0.005
    fps: Annotated[float, Range(above=0.0, unit="Hz")] = 1.0

    kind: ClassVar[str] = "images"
    needs: ClassVar[Needs] = Needs(poses=False)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write all images, by split if there are splits; `classes.txt` holds the class names.

        Raises:
            InputError: If there is no channel for masks or classes, or there are two lists of
                classes.
        """
        names = {self._label_names(sequence) for sequence in sequences}
        if len(names) > 1 and self.layout == "masks":
            raise InputError(
                f"The sequences have {len(names)} lists of classes; one folder of masks holds one. "
                "Export each organ separately, or lesions with --masks binary."
            )
        for sequence in sequences:
            root = folder / (sequence.split or "")
            for index in range(len(sequence)):
                name = f"{folder_name(sequence)}_{index:06d}.png"
                self._write_frame(root, name, sequence, index)
                advance()
        if self.layout == "masks":
            lines = "".join(f"{name}\n" for name in names.pop())
            write_bytes(folder / _CLASSES, lines.encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return a sequence for each folder of images; its class is in `values["class"]`.

        Raises:
            InputError: If there is no image, or a mask is missing.
        """
        files: dict[Path, list[Path]] = {}
        for path in listed(folder, "**/*"):
            if path.suffix.lower() in IMAGES:
                files.setdefault(path.parent, []).append(path)
        masks = {root: _masks_beside(root, files) for root in files}
        mask_folders = set(masks.values())
        roots = sorted(root for root in files if root not in mask_folders)
        if not roots:
            raise InputError(f"{folder} contains no images. Allowed: {', '.join(IMAGES)}.")
        path = folder / _CLASSES
        names = tuple(path.read_text("utf-8-sig").splitlines()) if path.exists() else ()
        return tuple(
            self._read_one(folder, sorted(files[root], key=_natural), masks[root], files, names)
            for root in roots
        )

    def _channel(self, sequence: FrameSequence) -> str:
        if self.masks == "auto":
            return "instance" if "instance" in sequence.channels else "label"
        return "instance" if self.masks == "binary" else "label"

    def _label_names(self, sequence: FrameSequence) -> tuple[str, ...]:
        wanted = "instance" if self.layout == "classes" else self._channel(sequence)
        require_channels(self.kind, sequence, (wanted,))
        if self.layout == "classes" and sequence.episode is None:
            raise InputError(
                f"Only episodes state their kinds of lesions; {sequence.name} is not from one. "
                "Export an episode, or --layout masks."
            )
        return sequence.label_names if wanted == "label" else ("background", "lesion")

    def _write_frame(self, root: Path, name: str, sequence: FrameSequence, index: int) -> None:
        image = sequence.image("rgb", index)
        if self.layout == "classes":
            assert sequence.episode is not None
            lesions = sequence.episode.head["organ"]["lesions"]
            kind = image_class(sequence.image("instance", index), lesions, self.min_fraction)
            files = [] if kind is None else [(inside(root, f"{kind}/{name}"), image)]
        else:
            channel = self._channel(sequence)
            mask = sequence.image(channel, index)
            if channel == "instance":
                instance = mask if sequence.episode is None else lesion_instances(mask)
                mask = np.where(instance > 0, 255, 0).astype(np.uint8)
            files = [(root / _IMAGES[0] / name, image), (root / _MASKS[0] / name, mask)]
        for path, _ in files:
            path.parent.mkdir(parents=True, exist_ok=True)
        write_images(files)

    def _read_one(
        self,
        folder: Path,
        paths: list[Path],
        masks: Path | None,
        files: dict[Path, list[Path]],
        names: tuple[str, ...],
    ) -> FrameSequence:
        root = paths[0].parent
        parts = root.relative_to(folder).parts
        values = {TIME: np.arange(len(paths)) / self.fps, FILE_NAME: np.array(_file_names(paths))}
        if parts and root.name not in (*_IMAGES, *SPLITS):
            values["class"] = np.array([root.name] * len(paths))
            names = names or ("background", root.name)
        channels = {"rgb": paths}
        if masks is not None:
            channels["label"] = _matching(paths, masks, files[masks])
        return FrameSequence(
            "/".join(parts) or root.name,
            tuple(channels),
            values,
            image_loader(channels, {"rgb": read_rgb, "label": partial(_read_mask, self.masks)}),
            label_names=names if masks is not None else (),
            split=next((part for part in parts if part in SPLITS), None),
        )


def _masks_beside(root: Path, files: dict[Path, list[Path]]) -> Path | None:
    """Folder of the masks of a folder of images; None if there is none."""
    names = _MASKS if root.name in _IMAGES else tuple(f"{root.name}_{mask}" for mask in _MASKS)
    return next((root.with_name(name) for name in names if root.with_name(name) in files), None)


def _matching(paths: list[Path], folder: Path, masks: list[Path]) -> list[Path]:
    """Masks of images: of the same name, optionally with `_mask` appended."""
    by_stem = {path.stem.removesuffix("_mask"): path for path in masks}
    missing = [path for path in paths if path.stem not in by_stem]
    if missing:
        raise InputError(
            f"{folder} lacks the masks of {missing[0].name} and {len(missing) - 1} more images. "
            "Add them, or remove the folder to read without masks."
        )
    return [by_stem[path.stem] for path in paths]


def file_name(sequence: FrameSequence, index: int) -> str:
    """Name of an image's file without its extension, if it has one; otherwise its index."""
    names = sequence.values.get(FILE_NAME)
    return f"{index:06d}" if names is None else str(names[index])


def _file_names(paths: list[Path]) -> list[str]:
    """Names without extensions; with them if two would be equal."""
    stems = [path.stem for path in paths]
    return stems if len({*stems}) == len(stems) else [path.name for path in paths]


def _natural(path: Path) -> list[str | int]:
    """Natural sort key: 10 comes after 9."""
    parts = _DIGITS.split(path.name)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)]


def _read_mask(kind: Masks, path: Path) -> NDArray:
    """Class of each pixel: 0 or 1 for a binary mask, indices otherwise."""
    stored = read_plane(path)
    is_binary = kind == "binary"
    if kind == "auto":
        is_binary = path.suffix.lower() in _JPEG or bool(stored.max() > 127)
    if is_binary:
        return (stored > 127).astype(np.uint8)
    return narrow(stored, np.uint8, f"classes of {path}")
