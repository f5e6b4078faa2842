"""Text files: tables, times, poses, YAML and camera matrices."""

from __future__ import annotations

import csv
import re
import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens.exchange import camera_matrix, lens_from_matrix, undistorted_pinhole
from vrcaps.core.errors import InputError, import_extra, narrow
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import (
    matrix_from_unit_quaternion,
    quaternion_from_matrix,
    transform_from,
)
from vrcaps.formats.shared.stored_images import image_size
from vrcaps.motion.replay import quaternion_order

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.camera.lens import AnyLens, LensPinhole
    from vrcaps.formats.format import Format
    from vrcaps.recording.frame_sequence import FrameSequence

TIMES = "times.txt"
"""Times of the frames [s], one per row; for layouts without times. Other readers ignore it."""
NANOSECOND = 1e-9
_MAX_TIME_DIFFERENCE = 0.02
"""Maximum time difference of associated rows [s], as in TUM RGB-D's tools."""
_SEPARATOR = re.compile(r"[\s,;]+")


def read_rows(path: Path, columns: int) -> np.ndarray:
    """Read the numbers [n columns] of a whitespace-separated table; lines with # are comments.

    Raises:
        InputError: If the file cannot be read or a row has another number of columns.
    """
    try:
        rows = np.loadtxt(path, ndmin=2, encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    if rows.shape[1] != columns:
        raise InputError(f"{path} has {rows.shape[1]} columns. Allowed: {columns}.")
    return rows


def rows_of(
    rows: Float[np.ndarray, "n c"], frames: Iterable[int], path: Path
) -> Float[np.ndarray, "m c"]:
    """Rows of frames, by indices from 0.

    Raises:
        InputError: If there are too few.
    """
    wanted = np.fromiter(frames, int)
    if len(wanted) and wanted.max() >= len(rows):
        raise InputError(f"{path} has {len(rows)} rows, but there is a frame {wanted.max()}.")
    return rows[wanted]


def write_times(folder: Path, sequence: FrameSequence) -> None:
    """Write the times of a sequence's frames."""
    text = "".join(f"{time:.9f}\n" for time in sequence.times)
    write_bytes(folder / TIMES, text.encode())


def read_times(folder: Path, numbers: Iterable[int], fps: float) -> Float[np.ndarray, " n"]:
    """Times of frames [s]: by index from `times.txt`, or index / `fps` without the file.

    Raises:
        InputError: If the file cannot be read or has too few rows.
    """
    frames = np.fromiter(numbers, int)
    path = folder / TIMES
    if not path.exists():
        return frames / fps
    return rows_of(read_rows(path, 1), frames, path)[:, 0]


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
            raise InputError(f"{path} has the time {row[0]!r} in row {number + 1}. Allowed: ns.")
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
    """Index of the time in `others` nearest to each of `times`; −1 without one within 20 ms."""
    if len(others) == 0:
        return np.full(len(times), -1)
    order = np.argsort(others, kind="stable")
    after = np.searchsorted(others[order], times).clip(1, max(len(others) - 1, 1))
    before = order[after - 1]
    after = order[np.minimum(after, len(others) - 1)]
    is_after = np.abs(others[after] - times) < np.abs(others[before] - times)
    nearest = np.where(is_after, after, before)
    return np.where(np.abs(others[nearest] - times) <= _MAX_TIME_DIFFERENCE, nearest, -1)


def plain_pinhole(form: Format, sequence: FrameSequence) -> LensPinhole:
    """Lens of a sequence, which must be a pinhole without distortion.

    Raises:
        InputError: If it is another lens; the message says what to do.
    """
    lens = None if sequence.camera is None else sequence.camera.lens
    return undistorted_pinhole(lens, form.kind, sequence.name)


def matrix_text(lens: LensPinhole) -> str:
    """Format K as three rows of text."""
    rows = (" ".join(f"{value:.12g}" for value in row) for row in camera_matrix(lens))
    return "".join(f"{row}\n" for row in rows)


def read_text_numbers(path: Path) -> list[float]:
    """Read all numbers of a text file, separated by whitespace or commas.

    Raises:
        InputError: If the file cannot be read or holds anything else.
    """
    try:
        return [
            float(cell) for cell in _SEPARATOR.split(path.read_text("utf-8-sig").strip()) if cell
        ]
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error


def read_matrix_camera(path: Path, image: Path) -> Camera:
    """Camera from a file with the nine numbers of K.

    Raises:
        InputError: If the file cannot be read, or does not hold nine numbers.
    """
    values = read_text_numbers(path)
    if len(values) != 9:
        raise InputError(
            f"{path} contains {len(values)} numbers. Allowed: the 9 of a camera matrix."
        )
    return camera_of(lens_from_matrix(values), image)


def camera_of(lens: AnyLens, image: Path) -> Camera:
    """Camera with a lens and the image size of a file."""
    height, width = image_size(image)
    return Camera("camera", lens, width, height)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read the table in a YAML file.

    Raises:
        InputError: If the file cannot be read or does not hold a table.
        MissingExtraError: If PyYAML is not installed.
    """
    yaml = import_extra("yaml", "formats", package="PyYAML")
    try:
        plain = yaml.safe_load(path.read_text("utf-8-sig"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"Cannot read {path}: {' '.join(str(error).split())}.") from error
    if not isinstance(plain, dict):
        raise InputError(f"{path} contains no table of keys and values.")
    return plain


def numbers_of(plain: Any, key: str, count: int, path: Path) -> list[float]:
    """Numbers of a key.

    Args:
        plain: Table with the key.
        key: Key of a list of numbers.
        count: Required number of values.
        path: Path of the file, for messages.

    Raises:
        InputError: If they are missing.
    """
    given = plain.get(key) if isinstance(plain, dict) else None
    try:
        values = [float(value) for value in given]  # type: ignore[union-attr]
    except (TypeError, ValueError):
        values = []
    if len(values) != count:
        text = reprlib.repr(given)[:80]
        raise InputError(f"{path} has {text} for {key}. Allowed: {count} numbers.")
    return values


def yaml_list(values: Iterable[float]) -> str:
    """Format numbers as a list; YAML reads ``1e-05`` as text, ``1.0e-05`` as a number."""
    texts = (repr(float(value)) for value in values)
    fixed = (t.replace("e", ".0e") if "e" in t and "." not in t else t for t in texts)
    return f"[{', '.join(fixed)}]"
