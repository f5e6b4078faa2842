"""EndoMapper's simulated sequences: color, depth as OpenEXR, trajectory from Unity.

``rgb/image_0000.png``, ``depth/aov_image_0000.exr`` (its red channel), ``calibration.txt``
(``fx: …``, no distortion), ``trajectory.csv`` (camera to world in Unity's left-handed frame, in
decimeters, quaternion xyzw, cells separated by ``;``, some rows damaged), ``rgb.txt`` and
``depth.txt`` (time and path), ``info.txt``.

Readers disagree on depth. NR-SLAM and a converter that names the data set's author interpret it as
Unity's reversed z-buffer v with near = 0.01 and far = 4, ``1/z = v/near + (1 − v)/far``; VSLAM-LAB
interprets it as decimeters. The z-buffer is the default here; its z is in decimeters, as is the
trajectory, so it ranges from 1 to 400 mm. Steps are those of 32-bit floats. Source:
https://www.synapse.org/Synapse:syn26707219.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.config.limits import check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.core.units import DM
from vrcaps.formats.endoscopy.exr_files import read_exr, write_exr
from vrcaps.formats.endoscopy.unity import frames_with_poses, recorder_text
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import each_folder, found_folders
from vrcaps.formats.shared.frame_files import by_number, image_loader, matched
from vrcaps.formats.shared.intrinsics import plain_pinhole
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_NEAR, _FAR = 0.01 * DM, 4.0 * DM
_TRAJECTORY, _CALIBRATION = "trajectory.csv", "calibration.txt"
_KEYS = ("fx", "fy", "cx", "cy", "cols", "rows")
Depth = Literal["z-buffer", "linear"]


@dataclass(frozen=True)
class EndoMapper:
    """EndoMapper, simulated: `rgb/`, `depth/*.exr`, `calibration.txt`, `trajectory.csv`.

    Attributes:
        depth: Encoding of depth images: `z-buffer`, as NR-SLAM reads them (near 1 mm, far
            400 mm), or `linear`, decimeters, as VSLAM-LAB reads them.
    """

    depth: Depth = "z-buffer"

    kind: ClassVar[str] = "endomapper"
    needs: ClassVar[Needs] = Needs(("rgb", "depth"), lenses=("pinhole",))

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence.

        Raises:
            InputError: If a lens has distortion.
            MissingExtraError: If OpenEXR is not installed.
        """
        for sequence, place in each_folder(sequences, folder):
            lens = plain_pinhole(self, sequence)
            lists = {"rgb": "image_{:04d}.png", "depth": "aov_image_{:04d}.exr"}
            for name, template in lists.items():
                (place / name).mkdir()
                paths = (f"{name}/{template.format(k)}" for k in range(len(sequence)))
                rows = zip(sequence.times, paths, strict=True)
                text = "".join(f"{time:.9f} {path}\n" for time, path in rows)
                write_bytes(place / f"{name}.txt", text.encode())
            for index in range(len(sequence)):
                image = place / "rgb" / lists["rgb"].format(index)
                write_images([(image, sequence.image("rgb", index))])
                depth = _stored_depth(self.depth, sequence.image("depth", index))
                write_exr(place / "depth" / lists["depth"].format(index), depth)
                advance()
            write_bytes(place / _TRAJECTORY, recorder_text(sequence, DM, ";").encode())
            write_bytes(place / "info.txt", f"name: {sequence.name}\n".encode())
            assert sequence.camera is not None
            values = (lens.fx, lens.fy, lens.cx, lens.cy)
            sizes = (sequence.camera.width, sequence.camera.height)
            rows = zip(_KEYS, (*values, *sizes), strict=True)
            text = "".join(f"{key}: {value:.12g}\n" for key, value in rows)
            write_bytes(place / _CALIBRATION, text.encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder. Frames whose row of poses is damaged are left out.

        Raises:
            InputError: If it is not in this layout.
        """
        places = found_folders(folder, _TRAJECTORY)
        return tuple(self._read_one(place, split) for place, split in places)

    def _read_one(self, place: Path, split: str | None) -> FrameSequence:
        frames = by_number(listed(place, "rgb/*.png"))
        frames, values = frames_with_poses(place / _TRAJECTORY, DM, frames)
        paths = matched({"rgb": frames, "depth": by_number(listed(place, "depth/*.exr"))})
        return FrameSequence(
            place.name,
            tuple(paths),
            values,
            image_loader(paths, {"rgb": read_rgb, "depth": partial(_read_depth, self.depth)}),
            _read_camera(place / _CALIBRATION),
            split=split,
        )


def _stored_depth(kind: Depth, depth: NDArray) -> NDArray:
    """Stored values of z [m]; 0 where there is no value."""
    z = depth.astype(float)
    if kind == "linear":
        return np.nan_to_num(z / DM)
    buffer = (1.0 / z - 1.0 / _FAR) / (1.0 / _NEAR - 1.0 / _FAR)
    return np.where((z >= _NEAR) & (z <= _FAR), buffer, 0.0)


def _read_depth(kind: Depth, path: Path) -> NDArray:
    stored = read_exr(path).astype(float)
    z = stored * DM if kind == "linear" else 1.0 / (stored / _NEAR + (1.0 - stored) / _FAR)
    return np.where(stored > 0.0, z, np.nan).astype(np.float32)


def _read_camera(path: Path) -> Camera:
    found = {}
    try:
        for line in path.read_text("utf-8-sig").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in _KEYS:
                found[key.strip()] = float(value)
        fx, fy, cx, cy, cols, rows = (found[key] for key in _KEYS)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"Cannot read {path}: {error}. It holds a line `key: number` for {', '.join(_KEYS)}."
        ) from error
    return Camera("camera", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), int(cols), int(rows))
