"""Poses of Unity cameras: left-handed, y up, quaternions xyzw.

The world becomes z up by swapping y and z, and the camera's y is flipped down:
``R_world_camera = S R_unity D``, ``p_world = S p_unity`` with D = diag(1, −1, 1). The rule
``T M T``, T = diag(1, −1, 1, 1), of these layouts' loaders gives the same camera in a world
rotated by 90° about x, with y down.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import (
    matrix_from_unit_quaternion,
    quaternion_from_matrix,
    transform_from,
)
from vrcaps.motion.replay import WORLD_FROM_Y_UP, Y_UP_CAMERA_FROM_CAMERA
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.recording.frame_sequence import FrameSequence

_WORLD, _CAMERA = WORLD_FROM_Y_UP["left"], Y_UP_CAMERA_FROM_CAMERA["left"]
_HEADER = ("tX", "tY", "tZ", "rX", "rY", "rZ", "rW", "time(s)")
_UNIT = 0.01
"""Maximum deviation of a quaternion's length from 1 in a valid row."""


def poses_from_unity(
    positions: Float[np.ndarray, "n 3"], xyzw: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 4 4"]:
    """``T_world_camera`` of Unity positions [m] and quaternions."""
    rotations = (
        _WORLD @ matrix_from_unit_quaternion(np.roll(xyzw, 1, axis=1), "a file of Unity") @ _CAMERA
    )
    return transform_from(rotations, positions @ _WORLD.T)


def unity_from_poses(
    Ts_world_camera: Float[np.ndarray, "n 4 4"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Unity positions [m] and quaternions xyzw; both maps are their own inverses."""
    wxyz = quaternion_from_matrix(_WORLD @ Ts_world_camera[:, :3, :3] @ _CAMERA)
    return Ts_world_camera[:, :3, 3] @ _WORLD.T, np.roll(wxyz, -1, axis=1)


def recorder_text(sequence: FrameSequence, unit: float, separator: str) -> str:
    """Rows ``tX tY tZ rX rY rZ rW time(s)`` of Unity's recorder below its header.

    Args:
        sequence: Sequence with poses.
        unit: Length unit [m].
        separator: Between cells.
    """
    positions, xyzw = unity_from_poses(sequence.Ts_world_camera)
    rows = np.column_stack([positions / unit, xyzw, sequence.times])
    cells = (separator.join(f"{value:.12g}" for value in row) for row in rows)
    return separator.join(_HEADER) + "\n" + "".join(f"{row}\n" for row in cells)


def read_recorder(path: Path, unit: float) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Times [s] and ``T_world_camera`` [n 4 4] of a file of Unity's recorder, by frame index.

    A truncated last row is left out. Unreadable rows are NaN, so that the others keep their frame
    indices.

    Args:
        path: The file; cells are separated by ``;`` or ``,``.
        unit: Its length unit [m].

    Raises:
        InputError: If the file cannot be read or has another header.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    separator = ";" if lines and ";" in lines[0] else ","
    header, *rows = [*csv.reader(lines, delimiter=separator)] or [[]]
    if tuple(cell.strip() for cell in header) != _HEADER:
        raise InputError(f"{path} does not start with the header {separator.join(_HEADER)}.")
    while rows and len(rows[-1]) < len(_HEADER):
        rows.pop()
    values = np.array([_numbers(row) for row in rows]).reshape(-1, len(_HEADER))
    length = np.linalg.norm(values[:, 3:7], axis=1)
    known = np.isfinite(values).all(axis=1) & (np.abs(length - 1.0) <= _UNIT)
    poses = np.full((len(values), 4, 4), np.nan)
    poses[known] = poses_from_unity(unit * values[known, :3], values[known, 3:7])
    return values[:, 7], poses


def _numbers(cells: list[str]) -> list[float]:
    """Eight numbers of a row; all NaN if it is malformed."""
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    return values if len(values) == len(_HEADER) else [np.nan] * len(_HEADER)


def frames_with_poses(
    path: Path, unit: float, frames: dict[int, Path]
) -> tuple[dict[int, Path], dict[str, np.ndarray]]:
    """Frames with a row in a recorder's file, by index, with times and poses.

    Frames whose row is truncated, damaged or missing are left out.

    Args:
        path: The file of the recorder.
        unit: Its length unit [m].
        frames: Images by index.

    Raises:
        InputError: If the file cannot be read, or no frame has a row.
    """
    times, poses = read_recorder(path, unit)
    kept = {
        number: image
        for number, image in frames.items()
        if number < len(poses) and np.isfinite(poses[number]).all()
    }
    if not kept:
        raise InputError(f"{path} has {len(poses)} rows, but none for an existing frame.")
    rows = list(kept)
    return kept, {TIME: times[rows], CAMERA_POSE: poses[rows]}
