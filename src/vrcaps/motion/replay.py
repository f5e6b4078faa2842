"""Replay of a recorded path: read it, put it into the world, sample it at the frames' times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.file_ref import FileRef, file_ref, path_of
from vrcaps.limits import check_fields
from vrcaps.motion.trajectory import (
    Trajectory,
    capsule_poses,
    require_inside,
    resample,
    trajectory_from_poses,
)
from vrcaps.transforms import matrix_from_quaternion, rotation_vector, transform_from
from vrcaps.units import DEG, parse_length
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

_IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
_HEADER = ["tX", "tY", "tZ", "rX", "rY", "rZ", "rW", "time(s)"]

WORLD_FROM_Y_UP = {
    "left": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
    "right": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""The world (z up) from a y-up world: left-handed (x right, y up, z ahead) or right-handed
(x right, y up, z back)."""
Y_UP_CAMERA_FROM_CAMERA = {
    "left": np.diag([1.0, -1.0, 1.0]),
    "right": np.diag([1.0, -1.0, -1.0]),
}
"""A y-up camera's own axes (y up; looks along +z if left-handed, −z if right-handed) from ours."""


@dataclass(frozen=True)
class Replay:
    """Follow a recorded path.

    Example:
        >>> motion = vrcaps.Replay("poses.txt", format="tum", unit="m")
        >>> vrcaps.record(vrcaps.Scenario(motion=motion), "runs/replay")

    Attributes:
        path: The file, relative to the working directory.
        format: `tum` (right-handed, OpenCV axes) or `unity-csv` (y up).
        unit: Length unit of the file, such as `m`, `dm` or `5cm`.
        handedness: Of a `unity-csv` file: `left` (Unity: looks along +z) or `right` (looks
            along −z).
        pose: Whose pose the file holds: `camera` (the device's first) or `capsule`.
        frame: Frame that the file's coordinates, with `T_frame_recording` applied, are in.
        T_frame_recording: Places the path, after its conversion to meters and a right-handed
            z-up (`unity-csv`) frame: four rows of four numbers.
        start: Time in the file of the first frame, from the file's first pose [s].
        allow_outside: Accept frames whose camera is outside the lumen.
    """

    path: FileRef | str
    format: Literal["tum", "unity-csv"]
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
        """The path in a model, see `MotionSettings.begin`; nothing is random, the wall at rest."""
        return replay(model, self, frames=frames, fps=fps)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", file_ref(self.path))
        check_fields(self)
        parse_length(self.unit)
        _require_rigid(np.array(self.T_frame_recording, float))


def replay(model: Model, settings: Replay, *, frames: int, fps: float) -> Trajectory:
    """Trajectory of the capsule along a recorded path, at the frames' times.

    Args:
        model: The capsule and the lumen it must stay in.
        settings: The path and how to read it.
        frames: Number of frames, at least 1.
        fps: Frames per second.

    Raises:
        InputError: If the file cannot be read, is too short, or takes a camera out of the lumen.
    """
    if settings.format == "tum":
        recorded = read_tum(path_of(settings.path), unit=settings.unit)
    else:
        path = path_of(settings.path)
        recorded = read_unity_csv(path, unit=settings.unit, handedness=settings.handedness)
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


def read_tum(path: str | Path, *, unit: str) -> Trajectory:
    """Read a TUM path: lines of ``timestamp tx ty tz qx qy qz qw``; ``#`` starts a comment.

    The poses map the tracked body (OpenCV axes for a camera) to the file's world.

    Args:
        path: The file, relative to the working directory.
        unit: Its length unit; the format's own definition says `m`.

    Raises:
        InputError: If the file cannot be read or a line is wrong; names the line.
    """
    scale = parse_length(unit)
    rows = []
    for number, line in enumerate(_read_lines(path), start=1):
        text = line.split("#", 1)[0].replace(",", " ")
        if text.strip():
            rows.append((number, text.split()))
    numbers, values = _numbers(path, rows, columns=8)
    times, positions, xyzw = values[:, 0], scale * values[:, 1:4], values[:, 4:8]
    rotations = _rotations(path, numbers, xyzw)
    return _trajectory(path, numbers, times, transform_from(rotations, positions), ())


def read_unity_csv(
    path: str | Path, *, unit: str, handedness: Literal["left", "right"]
) -> Trajectory:
    """Read a path as Unity recorders write it: ``tX;tY;tZ;rX;rY;rZ;rW;time(s)`` and one row a pose.

    Cells are separated by ``;`` (then decimal commas are allowed) or ``,``. Two faults of such
    recorders are mended and noted in `Trajectory.notes`: a last row that is cut off is dropped,
    and so is a first row from which the pose jumps (more than 30° and three times any later
    step, or ten times any later distance).

    A left-handed file has x right, y up, z ahead, and so has its camera. Swapping y and z makes
    it right-handed and z up (``T M T``), and flipping the camera's y gives OpenCV axes:
    ``R_world_camera = T R_file D`` with T the swap and D = diag(1, −1, 1). A right-handed file
    has z backwards and its camera looks along −z: T = (x, −z, y), D = diag(1, −1, −1).

    Args:
        path: The file, relative to the working directory.
        unit: Its length unit.
        handedness: Of the file's frame.

    Raises:
        InputError: If the file cannot be read or a row is wrong; names the line.
    """
    scale = parse_length(unit)
    if handedness not in WORLD_FROM_Y_UP:
        raise UnknownNameError("handedness", handedness, WORLD_FROM_Y_UP)
    lines = _read_lines(path)
    separator = ";" if lines and ";" in lines[0] else ","
    header = [cell.strip() for cell in lines[0].lstrip("\ufeff").split(separator)] if lines else []
    if header != _HEADER:
        raise InputError(f"{path} starts with {header}, not the header {separator.join(_HEADER)}.")
    rows = [
        (number, line.replace(",", ".").split(";") if separator == ";" else line.split(","))
        for number, line in enumerate(lines[1:], start=2)
        if line.strip()
    ]
    notes = []
    if rows and len(rows[-1][1]) < len(_HEADER):
        notes.append(f"Dropped line {rows[-1][0]}, the last, which is cut off.")
        rows.pop()
    numbers, values = _numbers(path, rows, columns=len(_HEADER))
    world, camera = WORLD_FROM_Y_UP[handedness], Y_UP_CAMERA_FROM_CAMERA[handedness]
    rotations = world @ _rotations(path, numbers, values[:, 3:7]) @ camera
    poses = transform_from(rotations, scale * values[:, :3] @ world.T)
    if _first_jumps(poses):
        notes.append(f"Dropped line {numbers[0]}, the first pose, from which the path jumps.")
        numbers, values, poses = numbers[1:], values[1:], poses[1:]
    return _trajectory(path, numbers, values[:, 7], poses, tuple(notes))


def _read_lines(path: str | Path) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"Cannot read the path file {path}: {error}.") from error


def _numbers(
    path: str | Path, rows: list[tuple[int, list[str]]], *, columns: int
) -> tuple[list[int], Float[np.ndarray, "n c"]]:
    """Line numbers and values of the rows; every value finite."""
    values = np.empty((len(rows), columns))
    for index, (number, cells) in enumerate(rows):
        if len(cells) != columns:
            raise InputError(
                f"{path} line {number} has {len(cells)} values, not {columns}"
                + (
                    ": decimal commas need ';' between values."
                    if len(cells) > columns
                    else "; only a cut-off last line of a CSV may be short."
                )
            )
        try:
            values[index] = [float(cell) for cell in cells]
        except ValueError as error:
            raise InputError(f"{path} line {number} holds no number: {error}.") from error
        if not np.all(np.isfinite(values[index])):
            raise InputError(
                f"{path} line {number} holds a value that is not finite ({' '.join(cells)}). "
                "Remove the line; the path is interpolated across it."
            )
    if len(rows) < 2:
        raise InputError(f"{path} holds {len(rows)} poses. A path needs at least 2.")
    return [number for number, _ in rows], values


def _rotations(
    path: str | Path, numbers: list[int], xyzw: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 3 3"]:
    length = np.linalg.norm(xyzw, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > 0.01)
    if len(wrong):
        raise InputError(
            f"{path} line {numbers[wrong[0]]} holds a quaternion of length {length[wrong[0]]:.4g}, "
            "not 1. Expected order: x y z w."
        )
    return matrix_from_quaternion(np.roll(xyzw, 1, axis=1))


def _first_jumps(poses: Float[np.ndarray, "n 4 4"]) -> bool:
    """Whether the step from the first pose stands out from all later ones."""
    if len(poses) < 4:
        return False
    turns = np.linalg.norm(rotation_vector(poses[:-1, :3, :3], poses[1:, :3, :3]), axis=1)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turned = turns[0] > 30.0 * DEG and turns[0] > 3.0 * turns[1:].max()
    return bool(turned or steps[0] > 10.0 * max(steps[1:].max(), 1e-12))


def _trajectory(
    path: str | Path,
    numbers: list[int],
    times: Float[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 4 4"],
    notes: tuple[str, ...],
) -> Trajectory:
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        raise InputError(
            f"{path} line {numbers[wrong[0] + 1]}: time {times[wrong[0] + 1]:.6g} s does not come "
            f"after {times[wrong[0]]:.6g} s. Times must increase."
        )
    return trajectory_from_poses(times, poses, notes=notes)


def _require_rigid(transform: Float[np.ndarray, "4 4"]) -> None:
    rigid = transform.shape == (4, 4) and np.all(np.isfinite(transform))
    if rigid:
        rotation = transform[:3, :3]
        rigid = (
            np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
            and np.linalg.det(rotation) > 0.0
            and np.array_equal(transform[3], [0.0, 0.0, 0.0, 1.0])
        )
    if not rigid:
        raise InputError(
            "T_frame_recording is no rigid transform. Allowed: four rows of four numbers, a "
            "rotation with determinant 1 and a last row 0 0 0 1; a scale goes into the unit."
        )
