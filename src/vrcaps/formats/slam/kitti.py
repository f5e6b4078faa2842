"""KITTI odometry: color images, times, a calibration, and a pose file for each sequence.

A row of ``poses/NN.txt`` is the upper 3×4 part of the camera-to-world matrix, row by row [m]; the
rows of ``calib.txt`` are projection matrices ``P = K [I | t]`` of rectified cameras in the frame of
camera 0, so a camera's center is ``-inv(K) P[:, 3]``. Ours is camera 2 (left, color), located at
camera 0. Loaders expect the row ``Tr``, the pose of a lidar; it is the identity here. The poses of
KITTI start at the identity; written ones are in the episode's world. Source: the development kit of
https://www.cvlibs.net/datasets/kitti/eval_odometry.php.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.camera.lens import LensPinhole
from vrcaps.camera.lens.exchange import camera_matrix
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import transform_from
from vrcaps.core.names import listed
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    image_loader,
    matched,
    with_names,
    write_names,
)
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.formats.shared.text_files import (
    TIMES,
    camera_of,
    plain_pinhole,
    read_rows,
    read_times,
    rows_of,
    write_times,
)
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_CAMERAS = (2, 0)
"""Cameras to read, by priority: left color, left gray."""
_CALIBRATION = "calib.txt"


@dataclass(frozen=True)
class Kitti:
    """KITTI odometry: `sequences/00/image_2/`, `calib.txt`, `times.txt`, `poses/00.txt`."""

    kind: ClassVar[str] = "kitti"
    needs: ClassVar[Needs] = Needs(lenses=("pinhole",))

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write the sequences as 00, 01, …; `sequences.json` holds their names and splits.

        Raises:
            InputError: If a lens has distortion.
        """
        (folder / "poses").mkdir()
        names = {f"{number:02d}": sequence for number, sequence in enumerate(sequences)}
        for name, sequence in names.items():
            matrix = np.column_stack([camera_matrix(plain_pinhole(self, sequence)), np.zeros(3)])
            root = folder / "sequences" / name
            (root / "image_2").mkdir(parents=True)
            for index in range(len(sequence)):
                path = root / "image_2" / f"{index:06d}.png"
                write_images([(path, sequence.image("rgb", index))])
                advance()
            rows = [f"P{index}: {_row(matrix)}\n" for index in range(4)]
            calibration = "".join([*rows, f"Tr: {_row(np.eye(4)[:3])}\n"])
            write_bytes(root / _CALIBRATION, calibration.encode())
            write_times(root, sequence)
            poses = "".join(f"{_row(pose[:3])}\n" for pose in sequence.Ts_world_camera)
            write_bytes(folder / "poses" / f"{name}.txt", poses.encode())
        write_names(folder, names)

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder, of the left color camera or else the left gray one.

        The sequences 11 to 21 of KITTI have no poses.

        Raises:
            InputError: If it is not in this layout.
        """
        roots = [root for root, _ in find_folders(folder, _CALIBRATION)]
        return with_names(folder, ((root.name, _read_one(root)) for root in roots))


def _row(matrix: NDArray) -> str:
    return " ".join(f"{value:.12e}" for value in matrix.ravel())


def _read_one(root: Path) -> FrameSequence:
    images = {k: by_number(listed(root, f"image_{k}/*.png")) for k in _CAMERAS}
    index = next((k for k in _CAMERAS if images[k]), None)
    if index is None:
        raise InputError(f"{root} has neither image_2/*.png nor image_0/*.png.")
    if not (root / TIMES).exists():
        raise InputError(f"{root} has no {TIMES}.")
    paths = matched({"rgb": images[index]})
    matrix = _projections(root / _CALIBRATION).get(f"P{index}")
    if matrix is None:
        raise InputError(f"{root / _CALIBRATION} has no row P{index}.")
    values = {TIME: read_times(root, images[index], 1.0)}
    poses = root.parent.parent / "poses" / f"{root.name}.txt"
    if poses.exists():
        rows = rows_of(read_rows(poses, 12), images[index], poses).reshape(-1, 3, 4)
        center = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
        Ts_world_camera_0 = transform_from(rows[..., :3], rows[..., 3])
        values[CAMERA_POSE] = Ts_world_camera_0 @ transform_from(np.eye(3), center)
    lens = LensPinhole(fx=matrix[0, 0], fy=matrix[1, 1], cx=matrix[0, 2], cy=matrix[1, 2])
    camera = camera_of(lens, paths["rgb"][0])
    loader = image_loader(paths, {"rgb": read_rgb})
    return FrameSequence(root.name, ("rgb",), values, loader, camera)


def _projections(path: Path) -> dict[str, NDArray]:
    """Matrices [3 4] of a calibration by name."""
    matrices = {}
    try:
        for line in filter(None, path.read_text("utf-8-sig").splitlines()):
            name, _, values = line.partition(":")
            matrices[name] = np.array(values.split(), float).reshape(3, 4)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    return matrices
