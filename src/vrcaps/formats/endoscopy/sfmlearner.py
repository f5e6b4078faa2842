"""Training tree of SC-SfMLearner, EndoSfMLearner and SfMLearner.

``train.txt`` and ``val.txt`` name folders; each has ``cam.txt`` (K, three rows) and JPEG images,
which the loaders sort as text, so indices have seven digits. They ignore PNG, and cut off the last
character of each line of the lists, so the last one also ends in a newline. Depth for validation is
a ``.npy`` of floats next to each image (their ``--dataset kitti``) or ``depth/*.png`` of 16 bits,
5,000 a unit (``nyu``). Their metrics only include depths above 0.1 units, up to 80 or 10, so the
unit is a centimeter here. ``poses.txt`` has rows of 3×4, camera to world [m], as SfMLearner's
preparation of KITTI writes them. Source: https://github.com/JiawangBian/SC-SfMLearner-Release and
https://github.com/CapsuleEndoscope/EndoSLAM.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import transform_from
from vrcaps.core.names import listed
from vrcaps.core.units import LENGTH_UNITS
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    folder_name,
    image_loader,
    matched,
    new_folder,
)
from vrcaps.formats.shared.stored_images import read_numbers, read_rgb, write_jpeg
from vrcaps.formats.shared.text_files import (
    matrix_text,
    plain_pinhole,
    read_matrix_camera,
    read_rows,
    read_times,
    rows_of,
    write_times,
)
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, SPLITS, TIME, FrameSequence
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_STEPS_A_UNIT = 5000
_POSES = "poses.txt"


@dataclass(frozen=True)
class SfmLearner:
    """SC-SfMLearner's training tree: `train.txt`, `SCENE/cam.txt`, `SCENE/0000000.jpg`.

    Attributes:
        depth: Files of depth: `npy` next to the images, `png` in a folder, or `none`.
        depth_unit: Length unit of depth; the loaders' metrics exclude values below 0.1.
        quality: JPEG quality, 100 is best.
        fps: Frames per second of data without `times.txt`, which only vrcaps writes.
    """

    depth: Literal["npy", "png", "none"] = "npy"
    depth_unit: Literal["m", "dm", "cm", "mm"] = "cm"
    quality: Annotated[int, Range(1, 100)] = 95
    fps: Annotated[float, Range(above=0.0, unit="Hz")] = 30.0

    kind: ClassVar[str] = "sfmlearner"
    needs: ClassVar[Needs] = Needs(lenses=("pinhole",))

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence, and the lists; without splits all are in `train.txt`.

        Raises:
            InputError: If a lens has distortion.
        """
        lists: dict[str, str] = {}
        for sequence in sequences:
            text = matrix_text(plain_pinhole(self, sequence))
            root = new_folder(folder, None, folder_name(sequence))
            write_bytes(root / "cam.txt", text.encode())
            for index in range(len(sequence)):
                write_jpeg(root / f"{index:07d}.jpg", sequence.image("rgb", index), self.quality)
                if "depth" in sequence.channels and self.depth != "none":
                    self._write_depth(root, index, sequence.image("depth", index))
                advance()
            write_times(root, sequence)
            rows = sequence.Ts_world_camera[:, :3].reshape(-1, 12)
            poses = "".join(" ".join(f"{value:.12g}" for value in row) + "\n" for row in rows)
            write_bytes(root / _POSES, poses.encode())
            part = sequence.split or "train"
            lists[part] = lists.get(part, "") + f"{root.name}\n"
        for part, names in lists.items():
            write_bytes(folder / f"{part}.txt", names.encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder; poses and depth are optional.

        Raises:
            InputError: If it is not in this layout.
        """
        splits = {}
        for part in SPLITS:
            path = folder / f"{part}.txt"
            if path.exists():
                splits |= {
                    name.strip().rstrip("/"): part
                    for name in path.read_text("utf-8-sig").splitlines()
                }
        roots = (root for root, _ in find_folders(folder, "cam.txt"))
        return tuple(
            self._read_one(root, splits.get(root.relative_to(folder).as_posix())) for root in roots
        )

    @property
    def _unit(self) -> float:
        return LENGTH_UNITS[self.depth_unit]

    def _write_depth(self, root: Path, index: int, depth: NDArray) -> None:
        if self.depth == "npy":
            stored = np.nan_to_num(depth / self._unit).astype(np.float32)
            write_images([(root / f"{index:07d}.npy", stored)])
            return
        (root / "depth").mkdir(exist_ok=True)
        stored = fixed_point("m", self._unit / _STEPS_A_UNIT).encode(depth)
        write_images([(root / "depth" / f"{index:07d}.png", stored)])

    def _read_one(self, root: Path, split: str | None) -> FrameSequence:
        frames = by_number(listed(root, "*.jpg"))
        if not frames:
            raise InputError(
                f"{root} contains no *.jpg; the loaders of this layout read nothing else."
            )
        depths = by_number(listed(root, "*.npy") or listed(root, "depth/*.png"))
        paths = matched({"rgb": frames, "depth": {} if self.depth == "none" else depths})
        values = {TIME: read_times(root, frames, self.fps)}
        poses = root / _POSES
        if poses.exists():
            rows = rows_of(read_rows(poses, 12), frames, poses).reshape(-1, 3, 4)
            values[CAMERA_POSE] = transform_from(rows[..., :3], rows[..., 3])
        return FrameSequence(
            root.name,
            tuple(paths),
            values,
            image_loader(paths, {"rgb": read_rgb, "depth": partial(_read_depth, self._unit)}),
            read_matrix_camera(root / "cam.txt", paths["rgb"][0]),
            split=split,
        )


def _read_depth(unit: float, path: Path) -> NDArray:
    stored = read_numbers(path)
    if path.suffix == ".png":
        return fixed_point("m", unit / _STEPS_A_UNIT).decode(stored)
    return np.where(stored > 0.0, stored * unit, np.nan).astype(np.float32)
