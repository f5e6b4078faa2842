"""VSLAM-LAB: layout of a framework that runs dozens of visual SLAM systems.

``rgb_0/``, ``depth_0/`` (16-bit PNG of z; ``depth_factor`` of the calibration is one meter),
``rgb.csv`` with times [ns] and paths, ``groundtruth.csv`` with rows of time [ns], position [m] and
quaternion xyzw of the *body*, ``calibration.yaml`` with `radtan5` for pinholes, `equid4` for
fisheyes, and ``T_BS``, camera to body. On writing, the body is the camera. Source:
https://github.com/VSLAM-LAB/VSLAM-LAB.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.names import inside
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import each_folder, found_folders
from vrcaps.formats.shared.frame_files import image_loader
from vrcaps.formats.shared.kalibr_lens import KALIBR_LENSES, is_fisheye, kalibr_values, lens_from
from vrcaps.formats.shared.stored_images import image_size, read_numbers, read_rgb
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
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_FRAMES, _TRUTH, _CALIBRATION = "rgb.csv", "groundtruth.csv", "calibration.yaml"
_XYZW, _WXYZ = (1, 2, 3, 0), (3, 0, 1, 2)
_MODELS = {"radtan4": (4, False), "radtan5": (5, False), "equid4": (4, True)}
"""Number of distortion coefficients and fisheye flag of each model."""


@dataclass(frozen=True)
class VslamLab:
    """VSLAM-LAB: `rgb_0/`, `depth_0/`, `rgb.csv`, `groundtruth.csv`, `calibration.yaml`.

    Attributes:
        depth_factor: Stored depth of one meter on writing; 100000 gives steps of 10 µm, up to
            655 mm. On reading it is taken from the calibration.
    """

    depth_factor: Annotated[float, Range(1.0)] = 100000.0

    kind: ClassVar[str] = "vslam-lab"
    needs: ClassVar[Needs] = Needs(lenses=KALIBR_LENSES)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence.

        Raises:
            InputError: If a pinhole has skew.
        """
        encoding = fixed_point("m", 1.0 / self.depth_factor)
        for sequence, place in each_folder(sequences, folder):
            calibration = self._calibration_text(sequence)
            channels = [name for name in ("rgb", "depth") if name in sequence.channels]
            for name in channels:
                (place / f"{name}_0").mkdir()
            rows = [",".join(f"ts_{name}_0 (ns),path_{name}_0" for name in channels)]
            for index, time in enumerate(nanoseconds(sequence)):
                images = {name: sequence.image(name, index) for name in channels}
                if "depth" in images:
                    images["depth"] = encoding.encode(images["depth"])
                paths = {name: f"{name}_0/{index:06d}.png" for name in channels}
                write_images([(place / paths[name], images[name]) for name in channels])
                rows.append(",".join(f"{time},{paths[name]}" for name in channels))
                advance()
            write_bytes(place / _FRAMES, "".join(f"{row}\n" for row in rows).encode())
            write_bytes(place / _CALIBRATION, calibration.encode())
            poses = "".join(
                f"{time},{','.join(f'{value:.12g}' for value in row)}\n"
                for time, row in pose_rows(sequence, _XYZW)
            )
            header = "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw\n"
            write_bytes(place / _TRUTH, f"{header}{poses}".encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder, of their first camera.

        The pose of an image is the nearest in time; images without one within 20 ms are left out.

        Raises:
            InputError: If it is not in this layout.
            MissingExtraError: If PyYAML is not installed.
        """
        return tuple(_read_one(place, split) for place, split in found_folders(folder, _FRAMES))

    def _calibration_text(self, sequence: FrameSequence) -> str:
        camera = sequence.camera
        assert camera is not None
        (fx, fy, cx, cy), distortion = kalibr_values(camera.lens, sequence.name, 5)
        has_depth = "depth" in sequence.channels
        depth = ("depth_name: depth_0", f"depth_factor: {self.depth_factor}") if has_depth else ()
        entries = (
            "cam_name: rgb_0",
            f"cam_type: {'rgb+depth' if has_depth else 'rgb'}",
            *depth,
            "cam_model: pinhole",
            f"distortion_type: {'equid4' if is_fisheye(camera.lens) else 'radtan5'}",
            f"focal_length: {yaml_list((fx, fy))}",
            f"principal_point: {yaml_list((cx, cy))}",
            f"distortion_coefficients: {yaml_list(distortion)}",
            f"image_dimension: [{camera.width}, {camera.height}]",
            f"fps: {frames_per_second(sequence):.12g}",
            f"T_BS: {yaml_list(np.eye(4).ravel())}",
        )
        listed = ",\n     ".join(entries)
        return f"%YAML 1.2\n---\n\ncameras:\n  - {{{listed}\n    }}\n"


def _read_one(place: Path, split: str | None) -> FrameSequence:
    path = place / _FRAMES
    rows = read_table(path)
    names = ("rgb", "depth") if rows and len(rows[0]) >= 4 else ("rgb",)
    if not rows or any(len(row) < 2 * len(names) for row in rows):
        raise InputError(f"{path} has no images, or a row without the path of one.")
    paths = {name: [inside(place, row[2 * k + 1]) for row in rows] for k, name in enumerate(names)}
    values = {TIME: np.array([int(row[0]) * NANOSECOND for row in rows])}
    entry = _first_camera(place / _CALIBRATION)
    if (place / _TRUTH).exists() and read_table(place / _TRUTH):
        known, poses = read_poses(place / _TRUTH, _WXYZ)
        pose = np.array(numbers_of(entry, "T_BS", 16, place / _CALIBRATION)).reshape(4, 4)
        nearest = nearest_rows(values[TIME], known)
        kept = np.flatnonzero(nearest >= 0)
        if len(kept) == 0:
            raise InputError(f"{place / _TRUTH} has no pose within 20 ms of an image.")
        paths = {name: [found[k] for k in kept] for name, found in paths.items()}
        values = {TIME: values[TIME][kept], CAMERA_POSE: poses[nearest[kept]] @ pose}
    readers: dict[str, Any] = {"rgb": read_rgb}
    if "depth" in names:
        (factor,) = numbers_of(
            {"depth_factor": [entry.get("depth_factor")]}, "depth_factor", 1, path
        )
        readers["depth"] = partial(_read_depth, 1.0 / factor)
    camera = _camera_of(entry, place / _CALIBRATION, paths["rgb"][0])
    return FrameSequence(
        place.name, names, values, image_loader(paths, readers), camera, split=split
    )


def _first_camera(path: Path) -> dict[str, Any]:
    cameras = read_yaml(path).get("cameras")
    if not isinstance(cameras, list) or not cameras or not isinstance(cameras[0], dict):
        raise InputError(f"{path} has no list of cameras.")
    return cameras[0]


def _camera_of(entry: dict[str, Any], path: Path, image: Path) -> Camera:
    focal = numbers_of(entry, "focal_length", 2, path)
    center = numbers_of(entry, "principal_point", 2, path)
    model = entry.get("distortion_type")
    if model is not None and model not in _MODELS:
        allowed = ", ".join(_MODELS)
        raise InputError(f"{path} has the distortion_type {model}. Allowed: {allowed}, or none.")
    count, fisheye = _MODELS.get(str(model), (0, False))
    distortion = numbers_of(entry, "distortion_coefficients", count, path) if count else []
    height, width = image_size(image)
    return Camera(
        "camera", lens_from([*focal, *center], distortion, fisheye=fisheye), width, height
    )


def _read_depth(step: float, path: Path) -> NDArray:
    return fixed_point("m", step).decode(read_numbers(path))
