"""Tables with times in nanoseconds, and association of rows by time."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, narrow
from vrcaps.core.transforms import (
    matrix_from_unit_quaternion,
    quaternion_from_matrix,
    transform_from,
)
from vrcaps.motion.replay import quaternion_order

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.recording.frame_sequence import FrameSequence

NANOSECOND = 1e-9
NEAR = 0.02
"""Maximum time difference of associated rows [s], as in TUM RGB-D's tools."""


def nanoseconds(sequence: FrameSequence) -> list[int]:
    """Times of the frames [ns].

    Raises:
        InputError: If a time is not finite, or beyond 64 bits.
    """
    steps = np.rint(sequence.times / NANOSECOND)
    return narrow(steps, np.int64, f"times [ns] of {sequence.name}").tolist()


def frames_per_second(sequence: FrameSequence) -> float:
    """Frame rate of a sequence [Hz]; 1 for a single frame."""
    return float(1.0 / np.median(np.diff(sequence.times))) if len(sequence) > 1 else 1.0


def pose_rows(
    sequence: FrameSequence, order: tuple[int, ...]
) -> list[tuple[int, Float[np.ndarray, " 7"]]]:
    """Time [ns], position [m] and quaternion of each frame; `order` permutes wxyz."""
    poses = sequence.Ts_world_camera
    wxyz = quaternion_from_matrix(poses[:, :3, :3])
    rows = np.column_stack([poses[:, :3, 3], wxyz[:, order]])
    return list(zip(nanoseconds(sequence), rows, strict=True))


def read_table(path: Path, order: str = "") -> list[list[str]]:
    """Cells of the rows of a CSV file, without its header and comments.

    Args:
        path: The file.
        order: Order of the components of quaternions, such as ``wxyz``; the header must not give
            another. Empty accepts any.

    Raises:
        InputError: If the file cannot be read, a row does not start with an integer, or the
            header gives quaternions in another order.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines) if row]
    if rows and not rows[0][0].isdigit():
        named = quaternion_order(" ".join(rows[0]))
        if order and named not in ("", order):
            raise InputError(f"{path} has quaternions in the order {named}. Allowed: {order}.")
        rows = rows[1:]
    for number, row in enumerate(rows):
        if not row[0].isdigit():
            raise InputError(f"{path} has {row[0]!r} for a time in row {number + 1}. Allowed: ns.")
    return rows


def read_poses(
    path: Path, order: tuple[int, ...]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Times [s] and poses of a table of time, position [m] and quaternion, then any columns.

    Args:
        path: The file.
        order: Column indices of w, x, y, z among the four of the quaternion.

    Raises:
        InputError: If the file cannot be read or a row has too few columns.
    """
    named = "".join(sorted("wxyz", key=lambda axis: order["wxyz".index(axis)]))
    rows = [row[:8] for row in read_table(path, named)]
    try:
        values = np.array(rows, float).reshape(-1, 8)
        turns = matrix_from_unit_quaternion(values[:, 4:][:, order], path)
    except ValueError as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    return values[:, 0] * NANOSECOND, transform_from(turns, values[:, 1:4])


def nearest_rows(
    times: Float[np.ndarray, " n"], others: Float[np.ndarray, " m"]
) -> Int[np.ndarray, " n"]:
    """Row of `others` nearest in time to each of `times`; −1 if none is within `NEAR`."""
    if len(others) == 0:
        return np.full(len(times), -1)
    order = np.argsort(others, kind="stable")
    after = np.searchsorted(others[order], times).clip(1, max(len(others) - 1, 1))
    before = order[after - 1]
    after = order[np.minimum(after, len(others) - 1)]
    is_after = np.abs(others[after] - times) < np.abs(others[before] - times)
    nearest = np.where(is_after, after, before)
    return np.where(np.abs(others[nearest] - times) <= NEAR, nearest, -1)
