"""EuRoC MAV: images named by their time, calibration in YAML, and trajectory of the body.

``mav0/cam0/data/NS.png`` with ``data.csv`` and ``sensor.yaml``;
``mav0/state_groundtruth_estimate0/data.csv`` has rows of time [ns], position [m] and quaternion
wxyz of the *body*, body to world; ``T_BS`` of ``sensor.yaml`` is camera to body. On writing, the
body is the camera. Rows end after the quaternion: EuRoC's velocities and biases are unknown for a
camera alone. Source:
https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.names import inside, listed
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import each_folder, found_folders
from vrcaps.formats.shared.frame_files import image_loader
from vrcaps.formats.shared.kalibr_lens import KALIBR_LENSES, is_fisheye, kalibr_values, lens_from
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.formats.shared.timed_rows import (
    NANOSECOND,
    frames_per_second,
    nanoseconds,
    nearest_rows,
    pose_rows,
    read_poses,
    read_table,
)
from vrcaps.formats.shared.yaml_files import numbers_of, read_yaml, yaml_list
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_TRUTH = "state_groundtruth_estimate0"
_WXYZ = (0, 1, 2, 3)
_HEADER = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
)
_MODELS = {"radial-tangential": False, "radtan": False, "equidistant": True, "none": False}
"""Fisheye flag of each distortion model."""


@dataclass(frozen=True)
class Euroc:
    """EuRoC MAV: `mav0/cam0/data/NS.png`, `sensor.yaml`, `state_groundtruth_estimate0/`."""

    kind: ClassVar[str] = "euroc"
    needs: ClassVar[Needs] = Needs(lenses=KALIBR_LENSES)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence, its camera as `cam0`.

        Raises:
            InputError: If a pinhole has skew or k3.
        """
        for sequence, place in each_folder(sequences, folder):
            calibration = _calibration_text(sequence)
            camera, truth = place / "mav0" / "cam0", place / "mav0" / _TRUTH
            (camera / "data").mkdir(parents=True)
            truth.mkdir()
            names = [f"{time}.png" for time in nanoseconds(sequence)]
            for index, name in enumerate(names):
                write_images([(camera / "data" / name, sequence.image("rgb", index))])
                advance()
            rows = "".join(f"{name[:-4]},{name}\n" for name in names)
            write_bytes(camera / "data.csv", f"#timestamp [ns],filename\n{rows}".encode())
            write_bytes(camera / "sensor.yaml", calibration.encode())
            poses = "".join(
                f"{time},{','.join(f'{value:.12g}' for value in row)}\n"
                for time, row in pose_rows(sequence, _WXYZ)
            )
            write_bytes(truth / "data.csv", f"{_HEADER}\n{poses}".encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder, one for each camera.

        The pose of an image is the nearest in time; images without one within 20 ms are left out.

        Raises:
            InputError: If it is not in this layout.
            MissingExtraError: If PyYAML is not installed.
        """
        return tuple(_read_all(folder))


def _read_all(folder: Path) -> Iterator[FrameSequence]:
    for place, split in found_folders(folder, "mav0/cam*/data.csv"):
        cameras = [path.parent for path in listed(place, "mav0/cam*/data.csv")]
        for camera in cameras:
            name = place.name if len(cameras) == 1 else f"{place.name}/{camera.name}"
            yield _read_one(camera, name, split)


def _read_one(place: Path, name: str, split: str | None) -> FrameSequence:
    rows = read_table(place / "data.csv")
    try:
        times = np.array([int(row[0]) * NANOSECOND for row in rows])
        paths = [inside(place, f"data/{row[1]}") for row in rows]
    except IndexError as error:
        raise InputError(f"{place / 'data.csv'} has a row without the name of an image.") from error
    camera, T_body_camera = _read_sensor(place / "sensor.yaml")
    values = {TIME: times}
    truth = place.parent / _TRUTH / "data.csv"
    if truth.exists():
        known, poses = read_poses(truth, _WXYZ)
        nearest = nearest_rows(times, known)
        kept = np.flatnonzero(nearest >= 0)
        if len(kept) == 0:
            raise InputError(f"{truth} has no pose within 20 ms of an image in {place}.")
        paths = [paths[k] for k in kept]
        values = {TIME: times[kept], CAMERA_POSE: poses[nearest[kept]] @ T_body_camera}
    loader = image_loader({"rgb": paths}, {"rgb": read_rgb})
    return FrameSequence(name, ("rgb",), values, loader, camera, split=split)


def _calibration_text(sequence: FrameSequence) -> str:
    camera = sequence.camera
    assert camera is not None
    values, distortion = kalibr_values(camera.lens, sequence.name, 4)
    model = "equidistant" if is_fisheye(camera.lens) else "radial-tangential"
    return f"""sensor_type: camera
comment: {json.dumps(sequence.name)}
T_BS:
  cols: 4
  rows: 4
  data: {yaml_list(np.eye(4).ravel())}
rate_hz: {frames_per_second(sequence):.12g}
resolution: [{camera.width}, {camera.height}]
camera_model: pinhole
intrinsics: {yaml_list(values)}
distortion_model: {model}
distortion_coefficients: {yaml_list(distortion)}
"""


def _read_sensor(path: Path) -> tuple[Camera, NDArray]:
    """Camera and its pose in the body frame."""
    plain = read_yaml(path)
    model = plain.get("distortion_model", "none")
    if model not in _MODELS:
        raise InputError(f"{path} has the distortion model {model}. Allowed: {', '.join(_MODELS)}.")
    width, height = (int(value) for value in numbers_of(plain, "resolution", 2, path))
    values = numbers_of(plain, "intrinsics", 4, path)
    distortion = numbers_of(plain, "distortion_coefficients", 4, path) if model != "none" else []
    lens = lens_from(values, distortion, fisheye=_MODELS[model])
    pose = np.array(numbers_of(plain.get("T_BS"), "data", 16, path)).reshape(4, 4)
    return Camera("camera", lens, width, height), pose
