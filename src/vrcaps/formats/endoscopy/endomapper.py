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
from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.fields import check_fields
from vrcaps.core.files import atomic_write, write_bytes
from vrcaps.core.names import listed
from vrcaps.core.units import DM
from vrcaps.formats.endoscopy.unity import frames_with_poses, recorder_text
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    image_loader,
    matched,
    sequence_folders,
)
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.formats.shared.text_files import plain_pinhole
from vrcaps.recording.frame_files import require_pixels, write_images
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Float
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
        for sequence, root in sequence_folders(sequences, folder):
            lens = plain_pinhole(self, sequence)
            lists = {"rgb": "image_{:04d}.png", "depth": "aov_image_{:04d}.exr"}
            for name, template in lists.items():
                (root / name).mkdir()
                paths = (f"{name}/{template.format(k)}" for k in range(len(sequence)))
                rows = zip(sequence.times, paths, strict=True)
                text = "".join(f"{time:.9f} {path}\n" for time, path in rows)
                write_bytes(root / f"{name}.txt", text.encode())
            for index in range(len(sequence)):
                image = root / "rgb" / lists["rgb"].format(index)
                write_images([(image, sequence.image("rgb", index))])
                depth = _stored_depth(self.depth, sequence.image("depth", index))
                write_exr(root / "depth" / lists["depth"].format(index), depth)
                advance()
            write_bytes(root / _TRAJECTORY, recorder_text(sequence, DM, ";").encode())
            write_bytes(root / "info.txt", f"name: {sequence.name}\n".encode())
            assert sequence.camera is not None
            values = (lens.fx, lens.fy, lens.cx, lens.cy)
            sizes = (sequence.camera.width, sequence.camera.height)
            rows = zip(_KEYS, (*values, *sizes), strict=True)
            text = "".join(f"{key}: {value:.12g}\n" for key, value in rows)
            write_bytes(root / _CALIBRATION, text.encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder. Frames whose row of poses is damaged are excluded.

        Raises:
            InputError: If it is not in this layout.
        """
        roots = find_folders(folder, _TRAJECTORY)
        return tuple(self._read_one(root, split) for root, split in roots)

    def _read_one(self, root: Path, split: str | None) -> FrameSequence:
        frames = by_number(listed(root, "rgb/*.png"))
        frames, values = frames_with_poses(root / _TRAJECTORY, DM, frames)
        paths = matched({"rgb": frames, "depth": by_number(listed(root, "depth/*.exr"))})
        return FrameSequence(
            root.name,
            tuple(paths),
            values,
            image_loader(paths, {"rgb": read_rgb, "depth": partial(_read_depth, self.depth)}),
            _read_camera(root / _CALIBRATION),
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
    parameters = {}
    try:
        for line in path.read_text("utf-8-sig").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in _KEYS:
                parameters[key.strip()] = float(value)
        fx, fy, cx, cy, cols, rows = (parameters[key] for key in _KEYS)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"Cannot read {path}: {error}. It must contain `key: number` for {', '.join(_KEYS)}."
        ) from error
    return Camera("camera", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), int(cols), int(rows))


def write_exr(path: Path, plane: Float[np.ndarray, "h w"]) -> None:
    """Write a plane as float32 in red, green and blue, compressed without loss (ZIP).

    Raises:
        MissingExtraError: If OpenEXR is not installed.
    """
    exr = import_extra("OpenEXR", "formats")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    planes = np.repeat(plane.astype(np.float32)[..., None], 3, axis=-1)
    with atomic_write(path) as temporary, exr.File(header, {"RGB": planes}) as file:
        file.write(str(temporary))


def read_exr(path: Path) -> Float[np.ndarray, "h w"]:
    """Read the red channel of an image.

    Raises:
        InputError: If the file cannot be read, has no red channel, or exceeds `MAX_PIXELS`.
        MissingExtraError: If OpenEXR is not installed.
    """
    exr = import_extra("OpenEXR", "formats")
    with reading(path):
        with exr.File(str(path), header_only=True) as file:
            low, high = (np.asarray(corner, int) for corner in file.header()["dataWindow"])
        width, height = (high - low + 1).tolist()
        require_pixels(width, height)
        with exr.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            pixels = channels["R"].pixels if "R" in channels else None
    if not isinstance(pixels, np.ndarray) or pixels.ndim != 2:
        raise InputError(f"{path} has no complete red channel.")
    return pixels.astype(np.float32)
