"""Estimated depth and poses of a sequence, read from files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError
from vrcaps.formats.folders import read_rows
from vrcaps.formats.tum import poses_of
from vrcaps.metrics.trajectory import TrajectoryAlignment, aligned_poses
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.image_files import read_image
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Float

_SLACK = 0.5
"""Largest difference of a pose's time from a frame's, in frames."""


def read_depth(folder: Path, sequence: FrameSequence) -> Callable[[int], np.ndarray]:
    """Reader of the depth [m] that was estimated of a sequence's frames.

    Args:
        folder: What `vrcaps predict depth` wrote.
        sequence: Of which images.

    Raises:
        InputError: If it holds none of this sequence; the reader, if a file is damaged.
    """
    place = folder / sequence.name
    if not place.is_dir():
        raise InputError(f"{folder} holds no depth of {sequence.name}: there is no {place}.")

    def read(index: int) -> np.ndarray:
        path = place / f"{index:06d}.png"
        try:
            return CHANNELS["depth"].encoding.decode(read_image(path))
        except (OSError, ValueError) as error:
            raise InputError(f"Cannot read {path}: {error}.") from error

    return read


def read_poses(
    path: Path, sequence: FrameSequence, align: TrajectoryAlignment
) -> Float[np.ndarray, "n 4 4"]:
    """Estimated ``T_world_camera`` of each frame, aligned to the true ones.

    Args:
        path: Rows ``timestamp tx ty tz qx qy qz qw``.
        sequence: Whose frames; each takes the pose of its time.
        align: What is fitted first.

    Raises:
        InputError: If a frame has no pose of its time, or the file cannot be read.
    """
    rows = read_rows(path, 8)
    apart = np.abs(rows[:, 0][None] - sequence.times[:, None])
    nearest = apart.argmin(axis=1)
    step = np.median(np.diff(sequence.times)) if len(sequence) > 1 else np.inf
    far = apart[np.arange(len(sequence)), nearest] > _SLACK * step
    if far.any():
        time = sequence.times[far][0]
        raise InputError(f"{path} has no pose of the frame at {time:.3f} s; {far.sum()} lack one.")
    poses = poses_of(rows[nearest])
    return poses if align == "none" else aligned_poses(poses, sequence.Ts_world_camera, align)
