"""Replay of a recorded path: read it, transform it to the world, sample it at frame times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from vrcaps.config.file_ref import FileRef, file_ref, path_of
from vrcaps.config.limits import check_fields
from vrcaps.core.transforms import require_rigid
from vrcaps.core.units import parse_length
from vrcaps.motion.trajectory import (
    Trajectory,
    capsule_poses,
    require_inside,
    resample,
    trajectory_from_poses,
)
from vrcaps.motion.trajectory_files import read_euroc_csv, read_tum, read_unity_csv
from vrcaps.world.model import Model

_IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Replay:
    """Replay of a recorded path.

    Example:
        >>> motion = vrcaps.Replay("poses.txt", format="tum", unit="m")
        >>> vrcaps.record(vrcaps.Scenario(motion=motion), "runs/replay")

    Attributes:
        path: The file, relative to the working directory.
        format: `tum` (right-handed, OpenCV axes), `euroc` (the same in CSV with nanoseconds and
            quaternions w first, as in EuRoC and TUM-VI) or `unity-csv` (y up).
        unit: Length unit of the file, such as `m`, `dm` or `5cm`.
        handedness: Handedness of a `unity-csv` file: `left` (Unity: looks along +z) or `right`
            (looks along −z).
        pose: Body whose pose is in the file: `camera` (the device's first) or `capsule`.
        frame: Frame of the file's coordinates after `T_frame_recording` is applied.
        T_frame_recording: Transform of the path, after its conversion to meters and a right-handed
            z-up (`unity-csv`) frame: four rows of four numbers.
        start: Time in the file of the first frame, relative to the file's first pose [s].
        allow_outside: Accept frames whose camera is outside the lumen.
    """

    path: FileRef | str
    format: Literal["tum", "euroc", "unity-csv"]
    unit: str
    handedness: Literal["left", "right"] = "left"
    pose: Literal["camera", "capsule"] = "camera"
    frame: Literal["world", "patient"] = "world"
    T_frame_recording: tuple[tuple[float, float, float, float], ...] = _IDENTITY
    start: float = 0.0
    allow_outside: bool = False

    kind: ClassVar[str] = "replay"
    column_names: ClassVar[tuple[str, ...]] = ()

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Trajectory:
        """Read the path in a model, see `MotionSettings.begin`; wall at rest, nothing random."""
        return replay(model, self, frames=frames, fps=fps)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", file_ref(self.path))
        check_fields(self)
        parse_length(self.unit)
        require_rigid(np.array(self.T_frame_recording, float), "T_frame_recording", 1e-6)


def replay(model: Model, settings: Replay, *, frames: int, fps: float) -> Trajectory:
    """Trajectory of the capsule along a recorded path, at the frames' times.

    Args:
        model: The capsule, and the lumen that contains it.
        settings: The path and its conventions.
        frames: Number of frames, at least 1.
        fps: Frames per second.

    Raises:
        InputError: If the file cannot be read, is too short, or leads a camera out of the
            lumen.
    """
    recorded = _read(settings)
    placement = np.array(settings.T_frame_recording, float)
    if settings.frame == "patient":
        placement = model.T_world_patient @ placement
    poses = placement @ recorded.Ts_world_capsule
    if settings.pose == "camera":
        poses = capsule_poses(poses, model.device.cameras[0].T_capsule_camera)
    path = trajectory_from_poses(recorded.times - recorded.times[0], poses, notes=recorded.notes)
    sampled = resample(path, settings.start + np.arange(frames) / fps)
    trajectory = Trajectory(
        np.arange(frames) / fps,
        sampled.Ts_world_capsule,
        sampled.linear_velocities_world,
        sampled.angular_velocities_world,
        sampled.notes,
    )
    if not settings.allow_outside:
        require_inside(model, trajectory)
    return trajectory


def _read(settings: Replay) -> Trajectory:
    """Path of a replay in the file's own frame, in meters."""
    path, unit = path_of(settings.path), settings.unit
    if settings.format == "unity-csv":
        return read_unity_csv(path, unit=unit, handedness=settings.handedness)
    return (read_tum if settings.format == "tum" else read_euroc_csv)(path, unit=unit)
