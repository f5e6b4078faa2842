"""Schedules of commands: wrench, posture and insufflation over time."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.fields import check_fields
from vrcaps.core.geometry import (
    rotate_vectors,
    rotation_from_vector,
    rotation_vector,
    transform_from,
)
from vrcaps.world.model import posture_transform

if TYPE_CHECKING:
    from jaxtyping import Float

WRENCH_COLUMNS = ("time_s", "fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm")
"""Header of a table of wrenches."""


@dataclass(frozen=True)
class Wrench:
    """Force and torque on the capsule's center of mass from a time onwards.

    Attributes:
        time: Time since the first frame [s].
        force: Force along x, y, z [N].
        torque: Torque about x, y, z [N·m].
    """

    time: float = 0.0
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self, of="Wrench")


@dataclass(frozen=True)
class PostureChange:
    """Change of the patient's posture.

    Attributes:
        posture: Posture afterwards, see `posture_transform`.
        time: Start of the change, since the first frame [s].
        duration: Duration of the change [s].
    """

    posture: str
    time: float = 0.0
    duration: float = 5.0

    def __post_init__(self) -> None:
        check_fields(self, of="PostureChange")


@dataclass(frozen=True)
class Insufflation:
    """Insufflation of the gut at a time.

    Attributes:
        time: Time since the first frame [s].
        factor: Factor on the lumen's radius, 1 = as modeled.
    """

    time: float = 0.0
    factor: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self, of="Insufflation")


@dataclass(frozen=True)
class Flush:
    """Rinse that washes off bubbles and chyme around the capsule.

    Attributes:
        time: Start time, since the first frame [s].
        duration: Time until all are removed [s].
    """

    time: float = 0.0
    duration: float = 2.0

    def __post_init__(self) -> None:
        check_fields(self, of="Flush")


def wrench_at(wrenches: tuple[Wrench, ...], time: float) -> Float[np.ndarray, "2 3"]:
    """Force [N] and torque [N·m] at a time: linear between entries, constant beyond them."""
    if not wrenches:
        return np.zeros((2, 3))
    rows = [(wrench.time, *wrench.force, *wrench.torque) for wrench in wrenches]
    return row_at(rows, time).reshape(2, 3)


def insufflation_at(insufflation: tuple[Insufflation, ...], time: float) -> float:
    """Factor on the lumen's radius at a time: linear between entries, constant beyond them."""
    if not insufflation:
        return 1.0
    return float(row_at([(entry.time, entry.factor) for entry in insufflation], time)[0])


def flush_between(flushes: tuple[Flush, ...], start: float, end: float) -> float:
    """Progress of a flush at the end of a step during which it was active, 0 to 1; else 0.

    Args:
        flushes: Flushes in order of time.
        start: Start of the step [s].
        end: End of the step [s].
    """
    fractions = [
        min(1.0, (end - flush.time) / flush.duration)
        for flush in flushes
        if start < flush.time + flush.duration and end > flush.time
    ]
    return max(fractions, default=0.0)


def row_at(rows: Sequence[tuple[float, ...]], time: float) -> Float[np.ndarray, " k"]:
    """Columns after the first, time: linear between rows, constant beyond them."""
    times, *columns = np.transpose(rows)
    return np.array([np.interp(time, times, column) for column in columns])


def patient_at(
    first: Float[np.ndarray, "4 4"], changes: tuple[PostureChange, ...], time: float
) -> Float[np.ndarray, "4 4"]:
    """``T_world_patient`` at a time, starting from the first posture.

    A change is the shortest rotation from one posture to the next, by the fraction x² (3 − 2x)
    after the fraction x of its duration, so that it starts and ends at rest.
    """
    rotation = first[:3, :3]
    for change in changes:
        fraction = np.clip((time - change.time) / change.duration, 0.0, 1.0)
        after = posture_transform(change.posture)[:3, :3]
        if fraction < 1.0:
            vector = fraction**2 * (3.0 - 2.0 * fraction) * rotation_vector(rotation, after)
            after = rotation_from_vector(vector) @ rotation
        rotation = after
    return transform_from(rotation, first[:3, 3])


def in_world(
    wrench: Float[np.ndarray, "2 3"], T_world_frame: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "2 3"]:
    """Convert force and torque along the axes of a frame to the world."""
    return rotate_vectors(T_world_frame, wrench)


def read_wrenches(path: str | Path) -> tuple[Wrench, ...]:
    """Read a table of wrenches: CSV with the header ``time_s,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm``.

    Raises:
        InputError: If the file cannot be read, its header differs or a line is invalid.
    """
    _, rows = read_numbers(path, (WRENCH_COLUMNS,), "wrenches")
    wrenches = [Wrench(t, (fx, fy, fz), (tx, ty, tz)) for t, fx, fy, fz, tx, ty, tz in rows]
    check_wrenches(tuple(wrenches), str(path))
    return tuple(wrenches)


def read_numbers(
    path: str | Path, headers: tuple[tuple[str, ...], ...], what: str
) -> tuple[tuple[str, ...], list[list[float]]]:
    """Read a CSV of numbers with one of several headers; returns the header and the rows.

    A truncated last line, from a writer that was killed, is omitted with a warning.

    Raises:
        InputError: If the file cannot be read, its header is none of them, a line is invalid or
            there are no rows.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"Cannot read the {what} {path}: {error}.") from error
    lines = text.splitlines()
    is_cut_off = len(lines) > 2 and not text.endswith("\n")
    if is_cut_off and not _is_row(lines[-1], len(lines[0].split(","))):
        warnings.warn(f"{path}: the last line is truncated and is ignored.", stacklevel=2)
        del lines[-1]
    header = tuple(cell.strip() for cell in lines[0].split(",")) if lines else ()
    if header not in headers:
        known = " or ".join(",".join(names) for names in headers)
        raise InputError(f"{path} starts with {','.join(header)!r}, not the header {known}.")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        cells = line.split(",")
        if not line.strip():
            continue
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError as error:
            raise InputError(
                f"{path} line {number} is not a row of {len(header)} numbers: {error}."
            ) from error
        if len(cells) != len(header):
            raise InputError(
                f"{path} line {number} is not a row of {len(header)} numbers: {line!r}."
            )
    if not rows:
        raise InputError(f"{path} contains no row of {what}. Give at least one.")
    return header, rows


def _is_row(line: str, count: int) -> bool:
    """Check that a line contains `count` numbers."""
    try:
        return len([float(cell) for cell in line.split(",")]) == count
    except ValueError:
        return False


def check_wrenches(wrenches: tuple[Wrench, ...], where: str) -> None:
    """Check that all numbers are finite and times increase.

    Raises:
        InputError: If not; names the entry.
    """
    require_series([(wrench.time, *wrench.force, *wrench.torque) for wrench in wrenches], where)


def check_insufflation(insufflation: tuple[Insufflation, ...], where: str) -> None:
    """Check that factors are within limits and times increase.

    Raises:
        InputError: If not; names the entry.
    """
    for index, entry in enumerate(insufflation):
        if not (np.isfinite(entry.time) and 0.2 <= entry.factor <= 2.0):
            raise InputError(
                f"{where}: entry {index} is {entry.factor} at {entry.time} s. Allowed: "
                "factors of 0.2 to 2 at finite times."
            )
    require_rising([entry.time for entry in insufflation], where)


def check_flushes(flushes: tuple[Flush, ...], where: str) -> None:
    """Check that durations are positive and times increase.

    Raises:
        InputError: If not; names the entry.
    """
    for index, flush in enumerate(flushes):
        if not (np.isfinite(flush.time) and 0.0 < flush.duration < np.inf):
            raise InputError(
                f"{where}: entry {index} takes {flush.duration} s at {flush.time} s. Allowed: "
                "above 0 s, at finite times."
            )
    require_rising([flush.time for flush in flushes], where)


def check_posture_changes(changes: tuple[PostureChange, ...], where: str) -> None:
    """Check that postures are known and changes do not overlap.

    Raises:
        InputError: If a change starts before the previous one has ended, or its times are invalid.
        UnknownNameError: If there is no such posture.
    """
    for change in changes:
        posture_transform(change.posture)
        if not (np.isfinite(change.time) and change.time >= 0.0):
            raise InputError(f"{where}: a turn starts at {change.time} s. Allowed: 0 s or later.")
        if not (np.isfinite(change.duration) and change.duration > 0.0):
            raise InputError(f"{where}: a turn takes {change.duration} s. Allowed: above 0 s.")
    for before, after in itertools.pairwise(changes):
        if after.time < before.time + before.duration:
            raise InputError(
                f"{where}: the turn to {after.posture} starts at {after.time:g} s, before the one "
                f"to {before.posture} ends at {before.time + before.duration:g} s. "
                "Give them in order."
            )


def require_series(rows: Sequence[tuple[float, ...]], where: str) -> None:
    """Check that rows are finite and that times, in their first column, increase.

    Raises:
        InputError: If not; names the entry.
    """
    for index, row in enumerate(rows):
        if not np.isfinite(row).all():
            raise InputError(f"{where}: entry {index} is not finite. Allowed: finite numbers.")
    require_rising([row[0] for row in rows], where)


def require_rising(times: list[float], where: str) -> None:
    """Check that times increase.

    Raises:
        InputError: If a time is not after the previous one.
    """
    for before, after in itertools.pairwise(times):
        if not after > before:
            raise InputError(f"{where}: time {after:g} s does not come after {before:g} s.")
