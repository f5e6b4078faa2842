"""Frame files: sorted by index, matched between channels, read on demand."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes
from vrcaps.core.names import listed
from vrcaps.formats.shared.folders import read_rows
from vrcaps.formats.shared.stored_images import IMAGES

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

    from vrcaps.recording.frame_sequence import FrameSequence

TIMES = "times.txt"
"""Times of the frames [s], one per row; for layouts without times. Other readers ignore it."""
_NUMBER = re.compile(r"\d+")

Reader = Callable[[Path], "NDArray"]
"""Reader of the image of one channel in SI units."""


def by_number(paths: Iterable[Path]) -> dict[int, Path]:
    """Files by the last number in their names, in numeric order: 10 after 9 without leading zeros.

    Raises:
        InputError: If a name has no number, or two have the same.
    """
    found: dict[int, Path] = {}
    for path in paths:
        numbers = _NUMBER.findall(path.stem)
        if not numbers:
            raise InputError(f"{path} has no number of a frame in its name.")
        if found.setdefault(int(numbers[-1]), path) != path:
            raise InputError(f"{path} and {found[int(numbers[-1])].name} have the same number.")
    return dict(sorted(found.items()))


def images_in(folder: Path) -> list[Path]:
    """Images in a folder, sorted by name, without hidden files."""
    return [path for path in listed(folder, "*") if path.suffix.lower() in IMAGES]


def matched(channels: Mapping[str, Mapping[int, Path]]) -> dict[str, list[Path]]:
    """Files of each channel for the frames of `rgb`; channels without files are left out.

    Raises:
        InputError: If a channel lacks a frame.
    """
    frames = channels["rgb"]
    paths = {"rgb": list(frames.values())}
    for name, found in channels.items():
        if not found:
            continue
        missing = [number for number in frames if number not in found]
        if missing:
            raise InputError(
                f"{frames[missing[0]]} has no {name} beside it, nor have {len(missing) - 1} more. "
                f"Add the files, or take those of {name} away."
            )
        paths[name] = [found[number] for number in frames]
    return paths


def image_loader(
    paths: Mapping[str, Sequence[Path]], readers: Mapping[str, Reader]
) -> Callable[[str, int], NDArray]:
    """Function that reads an image by channel and frame index, with the reader of its channel."""
    return partial(_load, paths, readers)


def _load(
    paths: Mapping[str, Sequence[Path]], readers: Mapping[str, Reader], channel: str, index: int
) -> NDArray:
    return readers[channel](paths[channel][index])


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
