"""EndoSLAM: synthetic frames of its UnityCam, and frames of its real cameras.

A sequence has ``Frames/image_0000.png``, ``Pixelwise Depths/aov_image_0000.png`` (z, one byte in
four equal planes, 1 cm per step) and ``Poses/*_position_rotation.csv``: camera to world in Unity's
left-handed frame, in decimeters, quaternion xyzw, one row per frame from 0; the last row is often
truncated. ``Calibration/cam.txt`` holds K. Of the real cameras only `Frames` have this form; frames
without such a file have no poses. Source: https://github.com/CapsuleEndoscope/EndoSLAM.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.camera.lens.exchange import camera_matrix
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.core.units import DM, MM
from vrcaps.formats.endoscopy.unity import frames_with_poses, recorder_text
from vrcaps.formats.format import Needs
from vrcaps.formats.shared.folders import (
    by_number,
    find_folders,
    folder_name,
    image_loader,
    images_in,
    matched,
    nearest_file,
    sequence_folders,
)
from vrcaps.formats.shared.stored_images import (
    IMAGES,
    read_plane,
    read_rgb,
    stored_steps,
    write_rgba,
)
from vrcaps.formats.shared.text_files import plain_pinhole, read_matrix_camera, read_times
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import TIME, FrameSequence
from vrcaps.render.encoding import fixed_point

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_FRAMES, _DEPTHS, _POSES, _CALIBRATION = "Frames", "Pixelwise Depths", "Poses", "Calibration"
_RECORDER = "*position_rotation*.csv"


@dataclass(frozen=True)
class EndoSlam:
    """EndoSLAM's UnityCam: `Frames/`, `Pixelwise Depths/`, `Poses/*.csv`, `Calibration/cam.txt`.

    Attributes:
        depth_step_mm: Depth per step of the stored byte [mm]. Readers of EndoSLAM expect 10;
            PolypSense3D uses 1, which reaches 255 mm.
        fps: Frames per second of data without a file of times and poses.
    """

    depth_step_mm: Annotated[float, Range(above=0.0, unit="mm")] = 10.0
    fps: Annotated[float, Range(above=0.0, unit="Hz")] = 30.0

    kind: ClassVar[str] = "endoslam"
    needs: ClassVar[Needs] = Needs(("rgb", "depth"), lenses=("pinhole",))

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write a folder for each sequence.

        Raises:
            InputError: If a lens has distortion.
        """
        for sequence, root in sequence_folders(sequences, folder):
            matrix = camera_matrix(plain_pinhole(self, sequence)).ravel()
            for name in (_FRAMES, _DEPTHS, _POSES, _CALIBRATION):
                (root / name).mkdir()
            for index in range(len(sequence)):
                frame = root / _FRAMES / f"image_{index:04d}.png"
                write_images([(frame, sequence.image("rgb", index))])
                depth = self._stored_depth(sequence.image("depth", index))
                path = root / _DEPTHS / f"aov_image_{index:04d}.png"
                write_rgba(path, np.repeat(depth[..., None], 4, axis=-1))
                advance()
            poses = root / _POSES / f"{folder_name(sequence)}_position_rotation.csv"
            write_bytes(poses, recorder_text(sequence, DM, ",").encode())
            row = ",".join(f"{value:.12g}" for value in matrix)
            write_bytes(root / _CALIBRATION / "cam.txt", f"{row}\n".encode())

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder; poses and `cam.txt` are optional.

        Frames whose row of poses is truncated or damaged are excluded.

        Raises:
            InputError: If it is not in this layout.
        """
        roots = find_folders(folder, f"{_FRAMES}/*")
        return tuple(self._read_one(root, folder, split) for root, split in roots)

    def _stored_depth(self, depth: NDArray) -> NDArray:
        steps = fixed_point("m", self.depth_step_mm * MM).encode(depth)
        return stored_steps(steps, np.uint8)

    def _read_one(self, root: Path, folder: Path, split: str | None) -> FrameSequence:
        frames = by_number(images_in(root / _FRAMES))
        if not frames:
            raise InputError(f"{root / _FRAMES} contains no image. Allowed: {', '.join(IMAGES)}.")
        recorders = sorted([*listed(root, _RECORDER), *listed(root, f"{_POSES}/*.csv")])
        if recorders:
            frames, values = frames_with_poses(recorders[0], DM, frames)
        else:
            values = {TIME: read_times(root, frames, self.fps)}
        depths = by_number(listed(root, f"{_DEPTHS}/*.png"))
        paths = matched({"rgb": frames, "depth": depths})
        intrinsics = nearest_file(root, folder, f"{_CALIBRATION}/cam.txt", "cam.txt")
        return FrameSequence(
            root.name,
            tuple(paths),
            values,
            image_loader(
                paths,
                {"rgb": read_rgb, "depth": partial(_read_depth, self.depth_step_mm * MM)},
            ),
            None if intrinsics is None else read_matrix_camera(intrinsics, paths["rgb"][0]),
            split=split,
        )


def _read_depth(step: float, path: Path) -> NDArray:
    return fixed_point("m", step).decode(read_plane(path))
