"""EuRoC MAV and VSLAM-LAB: images with times [ns], calibration in YAML, trajectory of the body.

EuRoC: ``mav0/cam0/data/NS.png`` with ``data.csv`` and ``sensor.yaml``;
``mav0/state_groundtruth_estimate0/data.csv`` has rows of time [ns], position [m] and quaternion
wxyz. Rows end after the quaternion: EuRoC's velocities and biases are unknown for a camera alone.

VSLAM-LAB, a framework that runs dozens of visual SLAM systems: ``rgb_0/``, ``depth_0/`` (16-bit PNG
of z; ``depth_factor`` of the calibration is one meter), ``rgb.csv`` with times [ns] and paths,
``groundtruth.csv`` with quaternions xyzw, ``calibration.yaml`` with `radtan5` for pinholes and
`equid4` for fisheyes.

Poses are those of the *body*, body to world; ``T_BS`` is camera to body. On writing, the body is
the camera. Sources:
https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets,
https://github.com/VSLAM-LAB/VSLAM-LAB.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens.exchange import DISTORTIONS, OPENCV_LENSES, OpenCvLens
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import inside, listed
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import find_folders, image_loader, sequence_folders
from vrcaps.formats.shared.stored_images import image_size, read_numbers, read_rgb
from vrcaps.formats.shared.text_files import (
    NANOSECOND,
    frames_per_second,
    nanoseconds,
    nearest_rows,
    numbers_of,
    pose_rows,
    read_poses,
    read_table,
    read_yaml,
    yaml_list,
)
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_GROUND_TRUTH = "state_groundtruth_estimate0"
_EUROC_HEADER = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
)
_FRAMES, _POSES, _CALIBRATION = "rgb.csv", "groundtruth.csv", "calibration.yaml"
_VSLAM_HEADER = "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw"


@dataclass(frozen=True)
class Euroc:
    """EuRoC MAV: `mav0/cam0/data/NS.png`, `sensor.yaml`, `state_groundtruth_estimate0/`."""

    kind: ClassVar[str] = "euroc"
    needs: ClassVar[Needs] = Needs(lenses=OPENCV_LENSES)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence, its camera as `cam0`.

        Raises:
            InputError: If a pinhole has skew or k3.
        """
        for sequence, root in sequence_folders(sequences, folder):
            calibration = _euroc_calibration(sequence)
            camera, truth = root / "mav0" / "cam0", root / "mav0" / _GROUND_TRUTH
            (camera / "data").mkdir(parents=True)
            truth.mkdir()
            names = [f"{time}.png" for time in nanoseconds(sequence)]
            for index, name in enumerate(names):
                write_images([(camera / "data" / name, sequence.image("rgb", index))])
                advance()
            rows = "".join(f"{name[:-4]},{name}\n" for name in names)
            write_bytes(camera / "data.csv", f"#timestamp [ns],filename\n{rows}".encode())
            write_bytes(camera / "sensor.yaml", calibration.encode())
            write_bytes(truth / "data.csv", _poses_text(_EUROC_HEADER, sequence, (0, 1, 2, 3)))

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder, one for each camera.

        The pose of an image is the nearest in time; images without one within 20 ms are left out.

        Raises:
            InputError: If it is not in this layout.
            MissingExtraError: If PyYAML is not installed.
        """
        return tuple(_read_euroc(folder))


@dataclass(frozen=True)
class VslamLab:
    """VSLAM-LAB: `rgb_0/`, `depth_0/`, `rgb.csv`, `groundtruth.csv`, `calibration.yaml`.

    Attributes:
        depth_factor: Stored depth of one meter on writing; 100000 gives steps of 10 µm, up to
            655 mm. On reading it is taken from the calibration.
    """

    depth_factor: Annotated[float, Range(1.0)] = 100000.0

    kind: ClassVar[str] = "vslam-lab"
    needs: ClassVar[Needs] = Needs(lenses=OPENCV_LENSES)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence.

        Raises:
            InputError: If a pinhole has skew.
        """
        encoding = fixed_point("m", 1.0 / self.depth_factor)
        for sequence, root in sequence_folders(sequences, folder):
            calibration = self._calibration_text(sequence)
            channels = [name for name in ("rgb", "depth") if name in sequence.channels]
            for name in channels:
                (root / f"{name}_0").mkdir()
            rows = [",".join(f"ts_{name}_0 (ns),path_{name}_0" for name in channels)]
            for index, time in enumerate(nanoseconds(sequence)):
                images = {name: sequence.image(name, index) for name in channels}
                if "depth" in images:
                    images["depth"] = encoding.encode(images["depth"])
                paths = {name: f"{name}_0/{index:06d}.png" for name in channels}
                write_images([(root / paths[name], images[name]) for name in channels])
                rows.append(",".join(f"{time},{paths[name]}" for name in channels))
                advance()
            write_bytes(root / _FRAMES, "".join(f"{row}\n" for row in rows).encode())
            write_bytes(root / _CALIBRATION, calibration.encode())
            write_bytes(root / _POSES, _poses_text(_VSLAM_HEADER, sequence, (1, 2, 3, 0)))

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder, of their first camera.

        The pose of an image is the nearest in time; images without one within 20 ms are left out.

        Raises:
            InputError: If it is not in this layout.
            MissingExtraError: If PyYAML is not installed.
        """
        return tuple(_read_vslam(root, split) for root, split in find_folders(folder, _FRAMES))

    def _calibration_text(self, sequence: FrameSequence) -> str:
        camera = sequence.camera
        assert camera is not None
        lens = OpenCvLens.of(camera.lens, sequence.name)
        has_depth = "depth" in sequence.channels
        depth = ("depth_name: depth_0", f"depth_factor: {self.depth_factor}") if has_depth else ()
        entries = (
            "cam_name: rgb_0",
            f"cam_type: {'rgb+depth' if has_depth else 'rgb'}",
            *depth,
            "cam_model: pinhole",
            f"distortion_type: {'equid4' if lens.is_fisheye else 'radtan5'}",
            f"focal_length: {yaml_list(lens.focal)}",
            f"principal_point: {yaml_list(lens.center)}",
            f"distortion_coefficients: {yaml_list(lens.distortion)}",
            f"image_dimension: [{camera.width}, {camera.height}]",
            f"fps: {frames_per_second(sequence):.12g}",
            f"T_BS: {yaml_list(np.eye(4).ravel())}",
        )
        text = ",\n     ".join(entries)
        return f"%YAML 1.2\n---\n\ncameras:\n  - {{{text}\n    }}\n"


def _poses_text(header: str, sequence: FrameSequence, order: tuple[int, ...]) -> bytes:
    rows = (
        f"{time},{','.join(f'{value:.12g}' for value in row)}\n"
        for time, row in pose_rows(sequence, order)
    )
    return f"{header}\n{''.join(rows)}".encode()


def _with_poses(
    times: NDArray, paths: Mapping[str, list[Path]], poses: tuple[NDArray, NDArray], missing: str
) -> tuple[dict[str, list[Path]], dict[str, NDArray]]:
    """Images with a camera pose within 20 ms, and their times [s] and poses.

    Args:
        times: Times of the images [s].
        paths: Images by channel.
        poses: Times [s] and camera poses of the trajectory.
        missing: Message if there is no such image.

    Raises:
        InputError: With the message, if there is none.
    """
    nearest = nearest_rows(times, poses[0])
    kept = np.flatnonzero(nearest >= 0)
    if len(kept) == 0:
        raise InputError(missing)
    values = {TIME: times[kept], CAMERA_POSE: poses[1][nearest[kept]]}
    return {name: [files[k] for k in kept] for name, files in paths.items()}, values


def _read_euroc(folder: Path) -> Iterator[FrameSequence]:
    for root, split in find_folders(folder, "mav0/cam*/data.csv"):
        cameras = [path.parent for path in listed(root, "mav0/cam*/data.csv")]
        for camera in cameras:
            name = root.name if len(cameras) == 1 else f"{root.name}/{camera.name}"
            yield _read_euroc_camera(camera, name, split)


def _read_euroc_camera(root: Path, name: str, split: str | None) -> FrameSequence:
    rows = read_table(root / "data.csv")
    try:
        values = {TIME: np.array([int(row[0]) * NANOSECOND for row in rows])}
        paths = {"rgb": [inside(root, f"data/{row[1]}") for row in rows]}
    except IndexError as error:
        raise InputError(f"{root / 'data.csv'} has a row without the name of an image.") from error
    camera, T_body_camera = _read_sensor(root / "sensor.yaml")
    truth = root.parent / _GROUND_TRUTH / "data.csv"
    if truth.exists():
        times, Ts_world_body = read_poses(truth, (0, 1, 2, 3))
        missing = f"{truth} has no pose within 20 ms of an image in {root}."
        poses = (times, Ts_world_body @ T_body_camera)
        paths, values = _with_poses(values[TIME], paths, poses, missing)
    loader = image_loader(paths, {"rgb": read_rgb})
    return FrameSequence(name, ("rgb",), values, loader, camera, split=split)


def _euroc_calibration(sequence: FrameSequence) -> str:
    camera = sequence.camera
    assert camera is not None
    lens = OpenCvLens.of(camera.lens, sequence.name, count=4)
    return f"""sensor_type: camera
comment: {json.dumps(sequence.name)}
T_BS:
  cols: 4
  rows: 4
  data: {yaml_list(np.eye(4).ravel())}
rate_hz: {frames_per_second(sequence):.12g}
resolution: [{camera.width}, {camera.height}]
camera_model: pinhole
intrinsics: {yaml_list((*lens.focal, *lens.center))}
distortion_model: {"equidistant" if lens.is_fisheye else "radial-tangential"}
distortion_coefficients: {yaml_list(lens.distortion)}
"""


def _read_sensor(path: Path) -> tuple[Camera, NDArray]:
    """Camera and its pose in the body frame."""
    plain = read_yaml(path)
    model, known = plain.get("distortion_model", "none"), DISTORTIONS["euroc"]
    if model not in known:
        raise InputError(f"{path} has the distortion model {model}. Allowed: {', '.join(known)}.")
    width, height = (int(value) for value in numbers_of(plain, "resolution", 2, path))
    fx, fy, cx, cy = numbers_of(plain, "intrinsics", 4, path)
    is_fisheye, count = known[model]
    distortion = numbers_of(plain, "distortion_coefficients", count, path) if count else []
    lens = OpenCvLens(is_fisheye, (fx, fy), (cx, cy), tuple(distortion)).lens()
    pose = np.array(numbers_of(plain.get("T_BS"), "data", 16, path)).reshape(4, 4)
    return Camera("camera", lens, width, height), pose


def _read_vslam(root: Path, split: str | None) -> FrameSequence:
    path, calibration, truth = root / _FRAMES, root / _CALIBRATION, root / _POSES
    rows = read_table(path)
    names = ("rgb", "depth") if rows and len(rows[0]) >= 4 else ("rgb",)
    if not rows or any(len(row) < 2 * len(names) for row in rows):
        raise InputError(f"{path} has no images, or a row without the path of one.")
    paths = {name: [inside(root, row[2 * k + 1]) for row in rows] for k, name in enumerate(names)}
    values = {TIME: np.array([int(row[0]) * NANOSECOND for row in rows])}
    entry = _first_camera(calibration)
    if truth.exists() and read_table(truth):
        times, Ts_world_body = read_poses(truth, (3, 0, 1, 2))
        T_body_camera = np.array(numbers_of(entry, "T_BS", 16, calibration)).reshape(4, 4)
        missing = f"{truth} has no pose within 20 ms of an image."
        poses = (times, Ts_world_body @ T_body_camera)
        paths, values = _with_poses(values[TIME], paths, poses, missing)
    readers: dict[str, Any] = {"rgb": read_rgb}
    if "depth" in names:
        given = {"depth_factor": [entry.get("depth_factor")]}
        (factor,) = numbers_of(given, "depth_factor", 1, path)
        readers["depth"] = partial(_read_depth, 1.0 / factor)
    camera = _vslam_camera(entry, calibration, paths["rgb"][0])
    loader = image_loader(paths, readers)
    return FrameSequence(root.name, names, values, loader, camera, split=split)


def _first_camera(path: Path) -> dict[str, Any]:
    cameras = read_yaml(path).get("cameras")
    if not isinstance(cameras, list) or not cameras or not isinstance(cameras[0], dict):
        raise InputError(f"{path} has no list of cameras.")
    return cameras[0]


def _vslam_camera(entry: dict[str, Any], path: Path, image: Path) -> Camera:
    fx, fy = numbers_of(entry, "focal_length", 2, path)
    cx, cy = numbers_of(entry, "principal_point", 2, path)
    model, known = entry.get("distortion_type"), DISTORTIONS["vslam-lab"]
    if model is not None and model not in known:
        allowed = ", ".join(known)
        raise InputError(f"{path} has the distortion_type {model}. Allowed: {allowed}, or none.")
    is_fisheye, count = known.get(str(model), (False, 0))
    distortion = numbers_of(entry, "distortion_coefficients", count, path) if count else []
    lens = OpenCvLens(is_fisheye, (fx, fy), (cx, cy), tuple(distortion)).lens()
    height, width = image_size(image)
    return Camera("camera", lens, width, height)


def _read_depth(step: float, path: Path) -> NDArray:
    return fixed_point("m", step).decode(read_numbers(path))
