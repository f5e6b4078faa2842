"""What formats of one folder per sequence share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from vrcaps.errors import InputError
from vrcaps.recording.frame_sequence import FrameSequence


def folder_name(sequence: FrameSequence) -> str:
    """Name of a sequence as one folder: `colon-0007_front`."""
    return sequence.name.replace("/", "_")


def each_folder(
    sequences: Sequence[FrameSequence], folder: Path
) -> Iterator[tuple[FrameSequence, Path]]:
    """Sequences with a new folder for each: by splits, where there are splits."""
    for sequence in sequences:
        place = folder / (sequence.split or "") / folder_name(sequence)
        place.mkdir(parents=True)
        yield sequence, place


def found_folders(folder: Path, mark: str) -> Iterator[tuple[Path, str | None]]:
    """Folders that hold a file of a name, sorted, with the split that they lie in.

    Args:
        folder: One sequence, or a folder of sequences at any depth.
        mark: Name of a file that every sequence has.

    Raises:
        InputError: If there is none.
    """
    places = sorted(path.parent for path in folder.rglob(mark))
    if not places:
        raise InputError(f"{folder} holds no {mark}, so no sequence in this layout.")
    for place in places:
        above = place.relative_to(folder).parts[:-1]
        yield place, above[0] if above and above[0] in ("train", "val", "test") else None


def read_rows(path: Path, columns: int) -> np.ndarray:
    """Numbers [n columns] of a text table with blanks between; lines with # are comments.

    Raises:
        InputError: If the file cannot be read or a row has another number of columns.
    """
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error
    if rows.shape[1] != columns:
        raise InputError(f"{path} has {rows.shape[1]} columns. Allowed: {columns}.")
    return rows
