"""C3VD: phantom colon with depth, normals, flow and poses, and the layouts of its readers.

Depth is z in 16 bits, 65,535 is 100 mm: 1.53 µm a step; 0 and 65,535 mean no value. Normals are
camera x, y, z from −1 to 1 in red, green, blue, 0 to 65,535. Flow goes to the frame *before*: x
and y from −20 to 20 px in red and green. A row of ``pose.txt`` is the *transpose* of the
camera-to-world matrix in millimeters: points are rows, ``p_world = p_camera T``. Where normals or
flow have no value, all planes are 0, as outside the image of the real endoscope.

C3VD's occlusions are pixels that hide something within 100 mm; those of an episode are points not
visible in the next frame, so they are neither written nor read. Source:
https://durrlab.github.io/C3VD and https://github.com/DurrLab/C3VD.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.core.units import MM
from vrcaps.formats.endoscopy import c3vd_cameras as cameras
from vrcaps.formats.format import Needs, require_channels
from vrcaps.formats.shared.folders import each_folder, folder_name, found_folders, new_folder
from vrcaps.formats.shared.frame_files import (
    by_number,
    image_loader,
    matched,
    read_times,
    rows_of,
    write_times,
)
from vrcaps.formats.shared.intrinsics import plain_pinhole
from vrcaps.formats.shared.stored_images import read_numbers, read_plane, read_rgb, write_tiff
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.formats.format import Advance

_FULL = 65535
_DEPTH = fixed_point("m", 100.0 * MM / _FULL)
_DEPTH_8_BITS = fixed_point("m", 100.0 * MM / 255)
_LARGEST = {"normal": 1.0, "flow_backward": 20.0}
"""Maximum absolute value of the stored range [1, px]."""

Layout = Literal["c3vd", "flat", "endogslam", "ppsnet", "endostreamdepth"]
_FLAT = {
    "rgb": "{}_color.png",
    "depth": "{}_depth.tiff",
    "normal": "{}_normals.tiff",
    "flow_backward": "{}_flow.tiff",
}
_FILES: dict[str, dict[str, str]] = {
    "c3vd": {
        "rgb": "rgb/{}.png",
        "depth": "depth/{}_depth.tiff",
        "normal": "normals/{}_normals.tiff",
        "flow_backward": "optical_flow/{}_flow.tiff",
    },
    "flat": _FLAT,
    "endogslam": {"rgb": "color/{}_color.png", "depth": "depth/{}_depth.tiff"},
    "ppsnet": {
        "rgb": "images/{}.png",
        "depth": "depths/{}.tiff",
        "normal": "normals/{}.tiff",
    },
    "endostreamdepth": _FLAT,
}
_POSES = {"ppsnet": "poses_gt.txt"}


@dataclass(frozen=True)
class C3vd:
    """C3VD: color, depth, normals and flow with poses, for an omnidirectional lens.

    Attributes:
        layout: Folder layout: of the data set (`rgb/0000.png`, `depth/0000_depth.tiff`, …), of its
            first release (`flat`: `0000_color.png`, …), or of a reader. EndoGSLAM and PPSNet need
            pinholes without distortion, PPSNet also normals.
        lens: Lens on reading: from the calibration, or the pinhole that EndoGSLAM fitted to the
            colonoscope of C3VD. Ignored on writing.
        fps: Frames per second of data without `times.txt`, which only vrcaps writes.
    """

    layout: Layout = "c3vd"
    lens: Literal["calibrated", "pinhole-fit"] = "calibrated"
    fps: Annotated[float, Range(above=0.0, unit="Hz")] = 30.0

    kind: ClassVar[str] = "c3vd"
    needs: ClassVar[Needs] = Needs(("rgb", "depth"), lenses=("pinhole", "scaramuzza"))

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence.

        Raises:
            InputError: If the reader of the layout needs a lens or a channel that is missing.
        """
        lists: dict[str, list[str]] = {}
        for sequence, place in self._folders(sequences, folder):
            self._write_camera(sequence, place)
            channels = [name for name in _FILES[self.layout] if name in sequence.channels]
            for name in channels:
                self._path(place, name, 0).parent.mkdir(exist_ok=True)
            for index in range(len(sequence)):
                for name in channels:
                    path = self._path(place, name, index)
                    _write_image(path, name, sequence.image(name, index))
                advance()
            self._write_poses(sequence, place)
            write_times(place, sequence)
            part = sequence.split or "train"
            lists.setdefault(part, []).append(place.relative_to(folder).as_posix())
        if self.layout == "ppsnet":
            for part, names in lists.items():
                write_bytes(folder / f"{part}.txt", (" ".join(names) + "\n").encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder; poses and calibration are optional.

        Raises:
            InputError: If it is not in this layout; the message names the detected layout.
        """
        try:
            places = [*found_folders(folder, self._pattern("rgb"))]
        except InputError as error:
            fits = [k for k, files in _FILES.items() if listed(folder, f"**/{_glob(files['rgb'])}")]
            hint = f" It fits the layout {fits[0]!r}." if fits else ""
            raise InputError(f"{error}{hint}") from None
        return tuple(self._read_one(place, folder, split) for place, split in places)

    def _folders(
        self, sequences: Sequence[FrameSequence], folder: Path
    ) -> Iterator[tuple[FrameSequence, Path]]:
        if self.layout != "endostreamdepth":
            yield from each_folder(sequences, folder)
            return
        for sequence in sequences:  # its loader has the splits itself, and ignores folders
            yield sequence, new_folder(folder, "cv3d", folder_name(sequence))

    def _path(self, place: Path, channel: str, index: int) -> Path:
        return place / _FILES[self.layout][channel].format(f"{index:04d}")

    def _pattern(self, channel: str) -> str:
        return _glob(_FILES[self.layout][channel])

    def _write_camera(self, sequence: FrameSequence, place: Path) -> None:
        assert sequence.camera is not None
        if self.layout == "endogslam":
            lens, step = plain_pinhole(self, sequence), 100.0 * MM / _FULL
            cameras.write_endogslam(place, lens, sequence.camera, step)
        elif self.layout == "ppsnet":
            require_channels("The layout ppsnet", sequence, ("normal",))
            cameras.write_ppsnet(place, plain_pinhole(self, sequence))
        else:
            cameras.write_calibration(place, sequence.camera)

    def _write_poses(self, sequence: FrameSequence, place: Path) -> None:
        poses = sequence.Ts_world_camera.copy()
        poses[:, :3, 3] /= MM
        if self.layout == "ppsnet":
            rows = (f"{k} {_joined(pose, ' ')}\n" for k, pose in enumerate(poses))
        else:
            rows = (f"{_joined(pose.T, ',')}\n" for pose in poses)
        write_bytes(place / _POSES.get(self.layout, "pose.txt"), "".join(rows).encode())

    def _read_one(self, place: Path, folder: Path, split: str | None) -> FrameSequence:
        found = {
            name: by_number(listed(place, self._pattern(name))) for name in _FILES[self.layout]
        }
        paths = matched(found)
        values = {TIME: read_times(place, found["rgb"], self.fps)}
        poses = place / _POSES.get(self.layout, "pose.txt")
        if poses.exists():
            rows = rows_of(_read_poses(poses), found["rgb"], poses)
            values[CAMERA_POSE] = rows if self.layout == "ppsnet" else rows.transpose(0, 2, 1)
            values[CAMERA_POSE][:, :3, 3] *= MM
        readers = {name: partial(_read_vectors, _LARGEST[name]) for name in _LARGEST}
        return FrameSequence(
            place.name,
            tuple(paths),
            values,
            image_loader(paths, {"rgb": read_rgb, "depth": _read_depth, **readers}),
            self._read_camera(place, folder, paths["rgb"][0]),
            split=split,
        )

    def _read_camera(self, place: Path, folder: Path, image: Path) -> Camera | None:
        if self.lens == "pinhole-fit":
            is_undistorted = self.layout in ("endogslam", "ppsnet")
            return cameras.fitted_camera(image, is_undistorted=is_undistorted)
        if self.layout == "endogslam":
            return cameras.read_endogslam(place, folder)
        if self.layout == "ppsnet":
            return cameras.read_ppsnet(place, image)
        return cameras.read_calibration(place, folder, image)


def _glob(template: str) -> str:
    return template.format("*")


def _joined(matrix: NDArray, separator: str) -> str:
    return separator.join(f"{value:.12g}" for value in matrix.ravel())


def _read_poses(path: Path) -> NDArray:
    """Matrices [n 4 4] from rows of 16 numbers; in PPSNet the frame index precedes them.

    Raises:
        InputError: If the file cannot be read or a row has another number of columns.
    """
    columns = 17 if path.name == _POSES["ppsnet"] else 16
    try:
        lines = path.read_text("utf-8-sig").replace(",", " ").splitlines()
        rows = np.array([line.split() for line in lines if line.strip()], float)
        return rows.reshape(-1, columns)[:, -16:].reshape(-1, 4, 4)
    except (OSError, ValueError) as error:
        raise InputError(
            f"Cannot read {path}: {error}. A row holds {columns} numbers, those of a pose last."
        ) from error


def _write_image(path: Path, channel: str, image: NDArray) -> None:
    if channel == "rgb":
        write_images([(path, image)])
    elif channel == "depth":
        stored = _DEPTH.encode(image)
        write_tiff(path, np.where(stored == _FULL, 0, stored).astype(np.uint16))
    else:
        write_tiff(path, _stored_vectors(image, _LARGEST[channel]))


def _stored_vectors(vectors: NDArray, largest: float) -> NDArray:
    """Three planes [h w 3] of 16 bits; all 0 where a component is NaN or out of range."""
    steps = np.rint((vectors.astype(float) / largest + 1.0) * (_FULL / 2))
    known = ((steps >= 0) & (steps <= _FULL)).all(axis=-1, keepdims=True)
    stored = np.where(known, steps, 0).astype(np.uint16)
    return np.concatenate([stored, np.zeros_like(stored)], axis=-1)[..., :3]


def _read_vectors(largest: float, path: Path) -> NDArray:
    stored = read_numbers(path)
    if stored.ndim != 3 or stored.dtype != np.uint16:
        raise InputError(f"{path} is no color image of 16 bits, but {stored.dtype}.")
    components = 3 if largest == _LARGEST["normal"] else 2
    values = (stored[..., :components] * (2.0 / _FULL) - 1.0) * largest
    values[~stored.any(axis=-1)] = np.nan
    return values.astype(np.float32)


def _read_depth(path: Path) -> NDArray:
    """Depth of 16 bits, or of the 8 bits that EndoGSLAM's preparation of C3VD leaves."""
    stored = read_plane(path)
    if stored.dtype == np.uint8:
        return _DEPTH_8_BITS.decode(stored)
    return _DEPTH.decode(np.where(stored == _FULL, 0, stored))
