"""What formats of one folder per sequence share."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vrcaps.data.plan import SPLITS
from vrcaps.errors import InputError
from vrcaps.files import write_json
from vrcaps.recording.frame_sequence import FrameSequence

_NAMES = "sequences.json"


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


def each_rig(
    sequences: Sequence[FrameSequence], folder: Path
) -> Iterator[tuple[tuple[FrameSequence, ...], Path]]:
    """Sequences of the cameras of one capsule together, with a new folder for each recording.

    A sequence of no episode is by itself.
    """
    for split, name, rig in recordings(sequences):
        place = folder / (split or "") / name
        place.mkdir(parents=True)
        yield rig, place


def recordings(
    sequences: Sequence[FrameSequence],
) -> Iterator[tuple[str | None, str, tuple[FrameSequence, ...]]]:
    """Split and name of each recording, with the sequences of its cameras."""
    rigs: dict[tuple[str | None, str], list[FrameSequence]] = {}
    for sequence in sequences:
        episode = sequence.episode
        name = folder_name(sequence) if episode is None else episode.name
        rigs.setdefault((sequence.split, name), []).append(sequence)
    for (split, name), rig in rigs.items():
        yield split, name, tuple(rig)


def found_folders(folder: Path, mark: str) -> Iterator[tuple[Path, str | None]]:
    """Folders that hold a file of a name, sorted, with the split that they lie in.

    Args:
        folder: One sequence, or a folder of sequences at any depth.
        mark: Path or pattern, from the sequence's folder, of a file that every sequence has.

    Raises:
        InputError: If there is none.
    """
    places = sorted({path.parents[mark.count("/")] for path in folder.rglob(mark)})
    if not places:
        raise InputError(f"{folder} holds no {mark}, so no sequence in this layout.")
    for place in places:
        yield place, split_of(place, folder)


def split_of(place: Path, folder: Path) -> str | None:
    """Split that a sequence lies in: the first folder on its path that is named like one."""
    above = place.relative_to(folder).parts[:-1]
    return next((part for part in above if part in SPLITS), None)


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


def write_names(folder: Path, places: Mapping[str, FrameSequence]) -> None:
    """Note what the sequences of a layout that numbers them are called; others do not look."""
    rows = {
        place: {"name": one.name, "patient": one.patient, "split": one.split}
        for place, one in places.items()
    }
    write_json(folder / _NAMES, rows)


def with_names(
    folder: Path, found: Iterable[tuple[str, FrameSequence]]
) -> tuple[FrameSequence, ...]:
    """Sequences with the names, patients and splits that `write_names` noted for their places.

    Raises:
        InputError: If the file of names is damaged.
    """
    path = folder / _NAMES
    if not path.exists():
        return tuple(sequence for _, sequence in found)
    try:
        rows = json.loads(path.read_text())
        return tuple(
            replace(sequence, **rows[place]) if place in rows else sequence
            for place, sequence in found
        )
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"Cannot read {path}: {error}. Remove it to read without names."
        ) from error
