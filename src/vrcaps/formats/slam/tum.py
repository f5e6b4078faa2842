"""TUM RGB-D: layout supported by most visual SLAM systems and by evo.

Rows of ``groundtruth.txt`` are ``timestamp tx ty tz qx qy qz qw``: seconds, meters, camera to
world, separated by one space. Depth is a 16-bit PNG of z; 5,000 is one meter by convention, i.e.
0.2 mm per step. Source: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens.exchange import lens_from_values, lens_values
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import (
    matrix_from_unit_quaternion,
    quaternion_from_matrix,
    transform_from,
)
from vrcaps.core.names import inside
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import find_folders, sequence_folders
from vrcaps.formats.shared.stored_images import read_plane, read_rgb, stored_steps
from vrcaps.formats.shared.text_files import camera_of, nearest_rows, read_rows
from vrcaps.motion.replay import tum_rows
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_TRUTH, _CALIBRATION = "groundtruth.txt", "calibration.txt"
_LENS = "fx fy cx cy k1 k2 p1 p2 k3"


@dataclass(frozen=True)
class Tum:
    """TUM RGB-D: `rgb/`, `depth/`, lists with times, `groundtruth.txt`.

    Attributes:
        depth_scale: Stored depth of one meter; readers expect 5000. 100000 stores steps of 10 µm,
            for readers with a scale option.
    """

    depth_scale: Annotated[float, Range(1.0)] = 5000.0

    kind: ClassVar[str] = "tum"
    needs: ClassVar[Needs] = Needs(lenses=("pinhole",))

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence."""
        for sequence, root in sequence_folders(sequences, folder):
            lists = {name: "" for name in ("rgb", "depth") if name in sequence.channels}
            for name in lists:
                (root / name).mkdir()
            for index, time in enumerate(sequence.times):
                images = {name: sequence.image(name, index) for name in lists}
                if "depth" in images:
                    images["depth"] = self._stored_depth(images["depth"])
                for name, image in images.items():
                    path = f"{name}/{index:06d}.png"
                    write_images([(root / path, image)])
                    lists[name] += f"{time:.9f} {path}\n"
                advance()
            for name, lines in lists.items():
                write_bytes(root / f"{name}.txt", lines.encode())
            write_bytes(root / _TRUTH, trajectory_text(sequence).encode())
            write_bytes(root / _CALIBRATION, _calibration_text(sequence).encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder; color images take the nearest depth and pose.

        Images without one within 20 ms are left out, as in the tools of TUM RGB-D.

        Raises:
            InputError: If it is not in this layout.
        """
        return tuple(self._read_one(root, split) for root, split in find_folders(folder, _TRUTH))

    def _stored_depth(self, depth: NDArray) -> NDArray:
        return stored_steps(depth * self.depth_scale)

    def _read_one(self, root: Path, split: str | None) -> FrameSequence:
        lists = {n: _read_list(root / f"{n}.txt") for n in ("rgb", "depth")}
        lists = {name: rows for name, rows in lists.items() if rows}
        if "rgb" not in lists:
            raise InputError(f"{root} has no rgb.txt, so it is not a TUM RGB-D sequence.")
        times = {name: np.array([time for time, _ in rows]) for name, rows in lists.items()}
        _, rows = tum_rows(root / _TRUTH)
        nearest = {name: nearest_rows(times["rgb"], own) for name, own in times.items()}
        nearest["pose"] = nearest_rows(times["rgb"], rows[:, 0])
        kept = np.flatnonzero(np.min(list(nearest.values()), axis=0) >= 0)
        if len(kept) == 0:
            raise InputError(f"{root} has no image with depth and pose within 20 ms of it.")
        paths = {
            name: [inside(root, own[k][1]) for k in nearest[name][kept]]
            for name, own in lists.items()
        }
        poses = poses_of(rows[nearest["pose"][kept]])
        return FrameSequence(
            root.name,
            tuple(lists),
            {TIME: times["rgb"][kept], CAMERA_POSE: poses},
            partial(_load, paths, self.depth_scale),
            _read_camera(root / _CALIBRATION, paths["rgb"][0]),
            split=split,
        )


def trajectory_text(sequence: FrameSequence) -> str:
    """Rows ``timestamp tx ty tz qx qy qz qw`` of a sequence."""
    poses = sequence.Ts_world_camera
    wxyz = quaternion_from_matrix(poses[:, :3, :3])
    rows = np.column_stack([poses[:, :3, 3], wxyz[:, 1:], wxyz[:, :1]])
    return "".join(
        f"{time:.9f} {' '.join(f'{value:.12g}' for value in row)}\n"
        for time, row in zip(sequence.times, rows, strict=True)
    )


def poses_of(rows: NDArray) -> NDArray:
    """``T_world_camera`` [n 4 4] of rows ``timestamp tx ty tz qx qy qz qw``."""
    rotations = matrix_from_unit_quaternion(rows[:, [7, 4, 5, 6]], "A TUM trajectory")
    return transform_from(rotations, rows[:, 1:4])


def _calibration_text(sequence: FrameSequence) -> str:
    """Parameters of a pinhole [px] in the order of `_LENS`."""
    assert sequence.camera is not None
    values = lens_values(sequence.camera.lens, _LENS)
    return " ".join(f"{value:.12g}" for value in values) + "\n"


def _read_camera(path: Path, image: Path) -> Camera | None:
    """Camera of a sequence; None without a calibration file."""
    if not path.exists():
        return None
    return camera_of(lens_from_values("pinhole", _LENS, read_rows(path, 9)[0].tolist()), image)


def _read_list(path: Path) -> list[tuple[float, str]]:
    """Times [s] and paths of images; empty if there is no list."""
    if not path.exists():
        return []
    lines = [line for line in path.read_text("utf-8-sig").splitlines() if line and line[0] != "#"]
    try:
        rows = [(float(time), name) for time, name in (line.split(maxsplit=1) for line in lines)]
    except ValueError as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    for time, name in rows:
        require(math.isfinite(time), f"{path}: time of {name}", time, "finite numbers")
    return rows


def _load(paths: dict[str, list[Path]], scale: float, channel: str, index: int) -> NDArray:
    path = paths[channel][index]
    if channel == "rgb":
        return read_rgb(path)
    stored = read_plane(path)
    return np.where(stored > 0, stored / scale, np.nan).astype(np.float32)
