"""C3VD: phantom colon with depth, normals, flow and poses, and the layouts of its readers.

Depth is z in 16 bits, 65,535 is 100 mm: 1.53 µm per step; 0 and 65,535 mean no value. Normals are
camera x, y, z from −1 to 1 in red, green, blue, 0 to 65,535. Flow goes to the frame *before*: x
and y from −20 to 20 px in red and green. A row of ``pose.txt`` is the *transpose* of the
camera-to-world matrix in millimeters: points are rows, ``p_world = p_camera T``. Where normals or
flow have no value, all planes are 0, as outside the image of the real endoscope.

C3VD's occlusions are pixels that hide something within 100 mm; those of an episode are points not
visible in the next frame, so they are neither written nor read.

``*_omnidirectional_values.txt`` holds ``width height cx cy a0 [a1] a2 a3 a4 c d e``: the Scaramuzza
model, a1 always 0. The data set's own loader counts pixels from 0 and uses the stretch matrix
[[c, d], [e, 1]]. Pinholes have ``*_pinhole_values.txt`` in the same form. EndoGSLAM reads a YAML
file, PPSNet ``camera.txt``, whose second to fifth words are fx fy cx cy. Source:
https://durrlab.github.io/C3VD and https://github.com/DurrLab/C3VD.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.camera.lens.exchange import lens_from_values, lens_values
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.core.units import MM
from vrcaps.formats.format import Needs, require_channels
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    folder_name,
    image_loader,
    matched,
    nearest_file,
    new_folder,
    sequence_folders,
)
from vrcaps.formats.shared.stored_images import (
    image_size,
    read_numbers,
    read_plane,
    read_rgb,
    write_tiff,
)
from vrcaps.formats.shared.text_files import (
    camera_of,
    numbers_of,
    plain_pinhole,
    read_text_numbers,
    read_times,
    read_yaml,
    rows_of,
    write_times,
)
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_MAX_STORED = 65535
_DEPTH = fixed_point("m", 100.0 * MM / _MAX_STORED)
_DEPTH_8_BITS = fixed_point("m", 100.0 * MM / 255)
_MAX_VALUES = {"normal": 1.0, "flow_backward": 20.0}
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
    "ppsnet": {"rgb": "images/{}.png", "depth": "depths/{}.tiff", "normal": "normals/{}.tiff"},
    "endostreamdepth": _FLAT,
}
_POSES = {"ppsnet": "poses_gt.txt"}
_CALIBRATIONS = {
    "scaramuzza": ("*omnidirectional_values.txt", "cx cy a0 a2 a3 a4 c d e"),
    "pinhole": ("*pinhole_values.txt", "fx fy cx cy k1 k2 p1 p2 k3"),
}
"""Calibration file of each kind of lens, and its parameters after width and height."""
_ENDOGSLAM, _PPSNET = "c3vd.yaml", "camera.txt"
_FIT = (802.319, 801.885, 668.286, 547.733, -0.42234, 0.10654)
"""fx, fy, cx, cy [px], k1, k2 of C3VD's colonoscope at 1350x1080 (EndoGSLAM, undisort.py)."""
_FIT_SIZE = (1350, 1080)


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
        for sequence, root in self._folders(sequences, folder):
            self._write_camera(sequence, root)
            channels = [name for name in _FILES[self.layout] if name in sequence.channels]
            for name in channels:
                self._path(root, name, 0).parent.mkdir(exist_ok=True)
            for index in range(len(sequence)):
                for name in channels:
                    path = self._path(root, name, index)
                    _write_image(path, name, sequence.image(name, index))
                advance()
            self._write_poses(sequence, root)
            write_times(root, sequence)
            part = sequence.split or "train"
            lists.setdefault(part, []).append(root.relative_to(folder).as_posix())
        if self.layout == "ppsnet":
            for part, names in lists.items():
                write_bytes(folder / f"{part}.txt", (" ".join(names) + "\n").encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder; poses and calibration are optional.

        Raises:
            InputError: If it is not in this layout; the message names the detected layout.
        """
        try:
            roots = [*find_folders(folder, _glob(_FILES[self.layout]["rgb"]))]
        except InputError as error:
            fits = [k for k, files in _FILES.items() if listed(folder, f"**/{_glob(files['rgb'])}")]
            hint = f" It fits the layout {fits[0]!r}." if fits else ""
            raise InputError(f"{error}{hint}") from None
        return tuple(self._read_one(root, folder, split) for root, split in roots)

    def _folders(
        self, sequences: Sequence[FrameSequence], folder: Path
    ) -> Iterator[tuple[FrameSequence, Path]]:
        if self.layout != "endostreamdepth":
            yield from sequence_folders(sequences, folder)
            return
        for sequence in sequences:  # its loader has the splits itself, and ignores folders
            yield sequence, new_folder(folder, "cv3d", folder_name(sequence))

    def _path(self, root: Path, channel: str, index: int) -> Path:
        return root / _FILES[self.layout][channel].format(f"{index:04d}")

    def _write_camera(self, sequence: FrameSequence, root: Path) -> None:
        assert sequence.camera is not None
        if self.layout == "endogslam":
            lens, step = plain_pinhole(self, sequence), 100.0 * MM / _MAX_STORED
            _write_endogslam(root, lens, sequence.camera, step)
        elif self.layout == "ppsnet":
            require_channels("The layout ppsnet", sequence, ("normal",))
            _write_ppsnet(root, plain_pinhole(self, sequence))
        else:
            _write_calibration(root, sequence.camera)

    def _write_poses(self, sequence: FrameSequence, root: Path) -> None:
        poses = sequence.Ts_world_camera.copy()
        poses[:, :3, 3] /= MM
        if self.layout == "ppsnet":
            rows = (f"{k} {_joined(pose, ' ')}\n" for k, pose in enumerate(poses))
        else:
            rows = (f"{_joined(pose.T, ',')}\n" for pose in poses)
        write_bytes(root / _POSES.get(self.layout, "pose.txt"), "".join(rows).encode())

    def _read_one(self, root: Path, folder: Path, split: str | None) -> FrameSequence:
        templates = _FILES[self.layout].items()
        files = {name: by_number(listed(root, _glob(path))) for name, path in templates}
        paths = matched(files)
        values = {TIME: read_times(root, files["rgb"], self.fps)}
        poses = root / _POSES.get(self.layout, "pose.txt")
        if poses.exists():
            rows = rows_of(_read_poses(poses), files["rgb"], poses)
            values[CAMERA_POSE] = rows if self.layout == "ppsnet" else rows.transpose(0, 2, 1)
            values[CAMERA_POSE][:, :3, 3] *= MM
        readers = {name: partial(_read_vectors, _MAX_VALUES[name]) for name in _MAX_VALUES}
        return FrameSequence(
            root.name,
            tuple(paths),
            values,
            image_loader(paths, {"rgb": read_rgb, "depth": _read_depth, **readers}),
            self._read_camera(root, folder, paths["rgb"][0]),
            split=split,
        )

    def _read_camera(self, root: Path, folder: Path, image: Path) -> Camera | None:
        if self.lens == "pinhole-fit":
            is_undistorted = self.layout in ("endogslam", "ppsnet")
            return _fitted_camera(image, is_undistorted=is_undistorted)
        if self.layout == "endogslam":
            return _read_endogslam(root, folder)
        if self.layout == "ppsnet":
            return _read_ppsnet(root, image)
        return _read_calibration(root, folder, image)


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
            f"Cannot read {path}: {error}. Rows must contain {columns} numbers, the pose last."
        ) from error


def _write_image(path: Path, channel: str, image: NDArray) -> None:
    if channel == "rgb":
        write_images([(path, image)])
    elif channel == "depth":
        stored = _DEPTH.encode(image)
        write_tiff(path, np.where(stored == _MAX_STORED, 0, stored).astype(np.uint16))
    else:
        write_tiff(path, _stored_vectors(image, _MAX_VALUES[channel]))


def _stored_vectors(vectors: NDArray, max_value: float) -> NDArray:
    """Three planes [h w 3] of 16 bits; all 0 where a component is NaN or out of range."""
    steps = np.rint((vectors.astype(float) / max_value + 1.0) * (_MAX_STORED / 2))
    known = ((steps >= 0) & (steps <= _MAX_STORED)).all(axis=-1, keepdims=True)
    stored = np.where(known, steps, 0).astype(np.uint16)
    return np.concatenate([stored, np.zeros_like(stored)], axis=-1)[..., :3]


def _read_vectors(max_value: float, path: Path) -> NDArray:
    stored = read_numbers(path)
    if stored.ndim != 3 or stored.dtype != np.uint16:
        raise InputError(f"{path} is not a color image of 16 bits, but {stored.dtype}.")
    components = 3 if max_value == _MAX_VALUES["normal"] else 2
    values = (stored[..., :components] * (2.0 / _MAX_STORED) - 1.0) * max_value
    values[~stored.any(axis=-1)] = np.nan
    return values.astype(np.float32)


def _read_depth(path: Path) -> NDArray:
    """Depth of 16 bits, or of the 8 bits that EndoGSLAM's preparation of C3VD leaves."""
    stored = read_plane(path)
    if stored.dtype == np.uint8:
        return _DEPTH_8_BITS.decode(stored)
    return _DEPTH.decode(np.where(stored == _MAX_STORED, 0, stored))


def _write_calibration(folder: Path, camera: Camera) -> None:
    """Write the lens of a camera as C3VD does, with a file that names the values."""
    pattern, names = _CALIBRATIONS[camera.lens.kind]
    values = (camera.width, camera.height, *lens_values(camera.lens, names))
    path = folder / pattern.replace("*", "camera_")
    write_bytes(path, (" ".join(f"{value:.17g}" for value in values) + "\n").encode())
    path = path.with_name(path.name.replace("values", "format"))
    write_bytes(path, f"width height {names}\n".encode())


def _read_calibration(folder: Path, top: Path, image: Path) -> Camera | None:
    """Camera of the nearest calibration in a sequence's folder or above; None if there is none.

    Raises:
        InputError: If it cannot be read, or is for another image size.
    """
    path = nearest_file(folder, top, *(pattern for pattern, _ in _CALIBRATIONS.values()))
    if path is None:
        return None
    kind = "pinhole" if path.match(_CALIBRATIONS["pinhole"][0]) else "scaramuzza"
    names = _CALIBRATIONS[kind][1]
    width, height, *values = read_text_numbers(path) or (0.0, 0.0)
    if len(values) == 10 and values[3] == 0.0:
        del values[3]  # a1
    if len(values) != 9:
        raise InputError(f"{path} has {2 + len(values)} numbers. Allowed: width height {names}.")
    rows, columns = image_size(image)
    if (height, width) != (rows, columns):
        raise InputError(
            f"{path} is for images of {width:g}x{height:g} pixels, but {image} has "
            f"{columns}x{rows}. Give a calibration of that size, or remove it."
        )
    return Camera("camera", lens_from_values(kind, names, values), int(width), int(height))


def _fitted_camera(image: Path, *, is_undistorted: bool) -> Camera:
    """Pinhole camera that EndoGSLAM fitted to C3VD's colonoscope, for images of any size.

    Args:
        image: One of the images.
        is_undistorted: Whether the images are undistorted.
    """
    height, width = image_size(image)
    across, down = width / _FIT_SIZE[0], height / _FIT_SIZE[1]
    fx, fy, cx, cy, *distortion = _FIT
    center = ((cx + 0.5) * across - 0.5, (cy + 0.5) * down - 0.5)
    values = (fx * across, fy * down, *center, *([0.0, 0.0] if is_undistorted else distortion))
    lens = lens_from_values("pinhole", "fx fy cx cy k1 k2", values)
    return Camera("camera", lens, width, height)


def _write_endogslam(folder: Path, lens: LensPinhole, camera: Camera, step: float) -> None:
    """Write the camera in EndoGSLAM's data set configuration; `step` [m] is the depth step."""
    scale = MM / step
    text = f"""dataset_name: c3vd
camera_params:
  image_height: {camera.height}
  image_width: {camera.width}
  fx: {lens.fx!r}
  fy: {lens.fy!r}
  cx: {lens.cx!r}
  cy: {lens.cy!r}
  png_depth_scale: {scale!r}
"""
    write_bytes(folder / _ENDOGSLAM, text.encode())


def _read_endogslam(folder: Path, top: Path) -> Camera | None:
    """Camera of the nearest `c3vd.yaml`; None if there is none.

    Raises:
        InputError: If it cannot be read.
    """
    path = nearest_file(folder, top, _ENDOGSLAM)
    if path is None:
        return None
    plain = read_yaml(path).get("camera_params")
    keys = ("fx", "fy", "cx", "cy", "image_width", "image_height")
    given = {"camera_params": [plain.get(key) for key in keys] if isinstance(plain, dict) else None}
    fx, fy, cx, cy, width, height = numbers_of(given, "camera_params", len(keys), path)
    return Camera("camera", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), int(width), int(height))


def _write_ppsnet(folder: Path, lens: LensPinhole) -> None:
    """Write `camera.txt`, one line of six words."""
    values = " ".join(map(repr, lens_values(lens, "fx fy cx cy")))
    write_bytes(folder / _PPSNET, f"pinhole {values} 0\n".encode())


def _read_ppsnet(folder: Path, image: Path) -> Camera:
    """Camera of `camera.txt`.

    Raises:
        InputError: If it cannot be read.
    """
    path = folder / _PPSNET
    try:
        _, *words, _ = path.read_text("utf-8-sig").splitlines()[0].split()
        lens = lens_from_values("pinhole", "fx fy cx cy", [float(word) for word in words])
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"Cannot read {path}: {error}. It must contain six words.") from error
    return camera_of(lens, image)
