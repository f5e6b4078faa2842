"""Replay of a recorded path: read it, transform it to the world, sample it at frame times.

Paths are TUM files, CSV of EuRoC and TUM-VI (ASL) and CSV of Unity's recorders. Layouts differ in
units of time and in the order of the quaternion, so a file read with the wrong layout would give a
wrong path without an error: each reader rejects the layouts of the others.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import FileRef, Range, check_fields, file_ref, path_of
from vrcaps.core.geometry import (
    invert,
    matrix_from_quaternion,
    require_rigid,
    rotation_vector,
    transform_from,
)
from vrcaps.core.units import DEG, parse_length
from vrcaps.motion.motion import MotionSettings
from vrcaps.motion.trajectory import Trajectory, resample, trajectory_from_poses
from vrcaps.world.model import Model
from vrcaps.world.wall_displacement import WallDisplacement

if TYPE_CHECKING:
    from jaxtyping import Float

_IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Replay(MotionSettings):
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
        rigid_wall: Whether the wall keeps its shape. Otherwise it yields to the shell where the
            lumen is narrower than the capsule, and a slack lumen closes around the capsule.
    """

    path: FileRef | str
    format: Literal["tum", "euroc", "unity-csv"]
    unit: str
    handedness: Literal["left", "right"] = "left"
    pose: Literal["camera", "capsule"] = "camera"
    frame: Literal["world", "patient"] = "world"
    T_frame_recording: tuple[tuple[float, float, float, float], ...] = _IDENTITY
    start: Annotated[float, Range()] = 0.0
    allow_outside: bool = False
    rigid_wall: bool = False

    kind: ClassVar[str] = "replay"

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Trajectory:
        """Read the path in a model, see `MotionSettings.begin`."""
        trajectory = replay(model, self, frames=frames, fps=fps)
        if self.rigid_wall:
            return trajectory
        return replace(trajectory, wall_displacement=WallDisplacement(model, shown or model))

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", file_ref(self.path))
        check_fields(self)
        parse_length(self.unit)
        require_rigid(np.array(self.T_frame_recording, float), "T_frame_recording", 1e-6)


def replay(model: Model, settings: Replay, *, frames: int, fps: float) -> Trajectory:
    """Trajectory of the capsule along a recorded path, at the frames' times; the wall is at rest.

    Args:
        model: The capsule, and the lumen that contains it.
        settings: The path and its conventions.
        frames: Number of frames, at least 1.
        fps: Frames per second.

    Raises:
        InputError: If the file cannot be read, is too short, or leads a camera out of the
            lumen.
    """
    recorded = _read_path(settings)
    placement = np.array(settings.T_frame_recording, float)
    if settings.frame == "patient":
        placement = model.T_world_patient @ placement
    poses = placement @ recorded.Ts_world_capsule
    if settings.pose == "camera":
        poses = poses @ invert(model.device.cameras[0].T_capsule_camera)
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
        model.require_inside(trajectory.Ts_world_capsule)
    return trajectory


def _read_path(settings: Replay) -> Trajectory:
    """Path of a replay in the file's own frame, in meters."""
    path, unit = path_of(settings.path), settings.unit
    if settings.format == "unity-csv":
        return read_unity_csv(path, unit=unit, handedness=settings.handedness)
    return (read_tum if settings.format == "tum" else read_euroc_csv)(path, unit=unit)


_HEADER = ["tX", "tY", "tZ", "rX", "rY", "rZ", "rW", "time(s)"]

WORLD_FROM_Y_UP = {
    "left": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
    "right": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Rotation to the world (z up) from a y-up world: left-handed (x right, y up, z ahead) or
right-handed (x right, y up, z back)."""
Y_UP_CAMERA_FROM_CAMERA = {
    "left": np.diag([1.0, -1.0, 1.0]),
    "right": np.diag([1.0, -1.0, -1.0]),
}
"""Rotation from OpenCV camera axes to those of a y-up camera (y up; looks along +z if left-handed,
−z if right-handed)."""

_LATEST = 1e12
"""Maximum time in a file in seconds [s]: larger values, beyond the year 33,000, are nanoseconds."""
_NANOSECOND = 1e-9
_QUATERNION = re.compile(r"\b(?:\w*_)?(?:q_?|q_\w+_)([wxyz])\b")
"""Name of a component of a quaternion in a header: qw, q_w, q_RS_w."""


def read_tum(path: str | Path, *, unit: str) -> Trajectory:
    """Read a TUM path: lines of ``timestamp tx ty tz qx qy qz qw``; ``#`` starts a comment.

    The poses map the tracked body (OpenCV axes for a camera) to the file's world.

    Args:
        path: The file, relative to the working directory.
        unit: Length unit of the file; the format's definition states `m`.

    Raises:
        InputError: If the file cannot be read, a line is wrong or the layout differs; states
            the line.
    """
    scale = parse_length(unit)
    line_numbers, values = tum_rows(path)
    positions, xyzw = scale * values[:, 1:4], values[:, 4:8]
    poses = transform_from(_rotations(path, line_numbers, np.roll(xyzw, 1, axis=1)), positions)
    return _trajectory(path, line_numbers, values[:, 0], poses, ())


def tum_rows(path: str | Path) -> tuple[list[int], Float[np.ndarray, "n 8"]]:
    """Line numbers and rows ``timestamp tx ty tz qx qy qz qw`` of a TUM file; all finite.

    Raises:
        InputError: If the file cannot be read, a line is wrong or the layout differs.
    """
    rows = []
    for line_number, line in enumerate(_read_lines(path), start=1):
        text, _, comment = line.partition("#")
        if quaternion_order(comment) == "wxyz":
            raise _no_tum(path, line_number, "its header names qw first")
        if "," in text:
            raise _no_tum(path, line_number, "it has commas")
        if text.strip():
            rows.append((line_number, text.split()))
    line_numbers, values = _numbers(path, rows, columns=8)
    if len(values) and np.abs(values[:, 0]).max() > _LATEST:
        raise _no_tum(path, line_numbers[0], f"the time {rows[0][1][0]} is in nanoseconds")
    return line_numbers, values


def _no_tum(path: str | Path, line_number: int, reason: str) -> InputError:
    return InputError(
        f"{path} line {line_number} is not in the layout TUM: {reason}. TUM has seconds and "
        "qx qy qz qw separated by blanks; CSV of EuRoC and TUM-VI (nanoseconds, qw first) has the "
        "format 'euroc'."
    )


def read_euroc_csv(path: str | Path, *, unit: str) -> Trajectory:
    """Read a path of EuRoC or TUM-VI (ASL): CSV of time [ns], position, quaternion wxyz.

    Further columns, such as velocities and biases, are ignored.

    Args:
        path: The file, relative to the working directory.
        unit: Length unit of the file; the format's definition states `m`.

    Raises:
        InputError: If the file cannot be read, a line is wrong or the layout differs; states the
            line.
    """
    scale = parse_length(unit)
    rows = []
    for line_number, line in enumerate(_read_lines(path), start=1):
        cells = [cell.strip() for cell in line.partition("#")[0].split(",")]
        if quaternion_order(line) == "xyzw":
            raise InputError(
                f"{path} line {line_number} names qx first. EuRoC's files have qw first."
            )
        if cells != [""] and not quaternion_order(line):
            rows.append((line_number, cells[:8]))
    line_numbers, values = _numbers(path, rows, columns=8)
    wrong = np.flatnonzero(values[:, 0] != np.rint(values[:, 0]))
    if len(wrong):
        raise InputError(
            f"{path} line {line_numbers[wrong[0]]} has the time {rows[wrong[0]][1][0]}. EuRoC's "
            "files have whole nanoseconds; a file in seconds, separated by blanks, has the format "
            "'tum'."
        )
    poses = transform_from(_rotations(path, line_numbers, values[:, 4:8]), scale * values[:, 1:4])
    return _trajectory(path, line_numbers, _NANOSECOND * values[:, 0], poses, ())


def quaternion_order(header: str) -> str:
    """Order of a quaternion's components in a header, such as ``wxyz``; or empty."""
    order = "".join(_QUATERNION.findall(header.lower()))
    return order if sorted(order) == sorted("wxyz") else ""


def read_unity_csv(
    path: str | Path, *, unit: str, handedness: Literal["left", "right"]
) -> Trajectory:
    """Read a path of Unity recorders: ``tX;tY;tZ;rX;rY;rZ;rW;time(s)`` and one pose per row.

    Cells are separated by ``;`` (then decimal commas are allowed) or ``,``. Two faults of such
    recorders are corrected and reported in `Trajectory.notes`: a truncated last row is dropped,
    and so is a first row from which the pose jumps (more than 30° and three times any later
    step, or ten times any later distance).

    A left-handed file has x right, y up, z ahead, and so has its camera. Swapping y and z makes
    it right-handed and z up (``T M T``), and flipping the camera's y gives OpenCV axes:
    ``R_world_camera = T R_file D`` with T the swap and D = diag(1, −1, 1). A right-handed file
    has z backwards and its camera looks along −z: T = (x, −z, y), D = diag(1, −1, −1).

    Args:
        path: The file, relative to the working directory.
        unit: Length unit of the file.
        handedness: Handedness of the file's frame.

    Raises:
        InputError: If the file cannot be read or a row is wrong; states the line.
    """
    scale = parse_length(unit)
    if handedness not in WORLD_FROM_Y_UP:
        raise UnknownNameError("handedness", handedness, WORLD_FROM_Y_UP)
    lines = _read_lines(path)
    separator = ";" if lines and ";" in lines[0] else ","
    header = [cell.strip() for cell in lines[0].split(separator)] if lines else []
    if header != _HEADER:
        raise InputError(f"{path} starts with {header}, not the header {separator.join(_HEADER)}.")
    rows = [
        (line_number, line.replace(",", ".").split(";") if separator == ";" else line.split(","))
        for line_number, line in enumerate(lines[1:], start=2)
        if line.strip()
    ]
    notes = []
    if rows and len(rows[-1][1]) < len(_HEADER):
        notes.append(f"Dropped line {rows[-1][0]}, the last, which is cut off.")
        rows.pop()
    line_numbers, values = _numbers(path, rows, columns=len(_HEADER))
    world, camera = WORLD_FROM_Y_UP[handedness], Y_UP_CAMERA_FROM_CAMERA[handedness]
    rotations = world @ _rotations(path, line_numbers, np.roll(values[:, 3:7], 1, axis=1)) @ camera
    poses = transform_from(rotations, scale * values[:, :3] @ world.T)
    if _first_jumps(poses):
        notes.append(f"Dropped line {line_numbers[0]}, the first pose, from which the path jumps.")
        line_numbers = line_numbers[1:]
        values, poses = values[1:], poses[1:]
    return _trajectory(path, line_numbers, values[:, 7], poses, tuple(notes))


def _read_lines(path: str | Path) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"Cannot read the path file {path}: {error}.") from error


def _numbers(
    path: str | Path, rows: list[tuple[int, list[str]]], *, columns: int
) -> tuple[list[int], Float[np.ndarray, "n c"]]:
    """Line numbers and values of the rows; every value finite."""
    values = np.empty((len(rows), columns))
    for index, (line_number, cells) in enumerate(rows):
        if len(cells) != columns:
            raise InputError(
                f"{path} line {line_number} has {len(cells)} values, not {columns}"
                + (
                    ": decimal commas need ';' between values."
                    if len(cells) > columns
                    else "; only a cut-off last line of a CSV may be short."
                )
            )
        try:
            values[index] = [float(cell) for cell in cells]
        except ValueError as error:
            raise InputError(
                f"{path} line {line_number} does not contain a number: {error}."
            ) from error
        if not np.all(np.isfinite(values[index])):
            raise InputError(
                f"{path} line {line_number} contains a value that is not finite "
                f"({' '.join(cells)}). Remove the line: the path is interpolated across it."
            )
    return [line_number for line_number, _ in rows], values


def _rotations(
    path: str | Path, line_numbers: list[int], wxyz: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 3 3"]:
    length = np.linalg.norm(wxyz, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > 0.01)
    if len(wrong):
        raise InputError(
            f"{path} line {line_numbers[wrong[0]]} contains a quaternion of length "
            f"{length[wrong[0]]:.4g}, not 1."
        )
    return matrix_from_quaternion(wxyz)


def _first_jumps(poses: Float[np.ndarray, "n 4 4"]) -> bool:
    """Check whether the step from the first pose is an outlier compared with all later ones."""
    if len(poses) < 4:
        return False
    turns = np.linalg.norm(rotation_vector(poses[:-1, :3, :3], poses[1:, :3, :3]), axis=1)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turned = turns[0] > 30.0 * DEG and turns[0] > 3.0 * turns[1:].max()
    return bool(turned or steps[0] > 10.0 * max(steps[1:].max(), 1e-12))


def _trajectory(
    path: str | Path,
    line_numbers: list[int],
    times: Float[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 4 4"],
    notes: tuple[str, ...],
) -> Trajectory:
    require_rigid(poses, path)
    if len(times) < 2:
        raise InputError(f"{path} contains {len(times)} poses. Allowed: 2 or more.")
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        raise InputError(
            f"{path} line {line_numbers[wrong[0] + 1]}: time {times[wrong[0] + 1]:.6g} s does not "
            f"come after {times[wrong[0]]:.6g} s. Times must increase."
        )
    return trajectory_from_poses(times, poses, notes=notes)
