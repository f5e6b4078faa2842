"""Shared functions of formats with one folder per sequence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_json
from vrcaps.core.names import inside, listed
from vrcaps.recording.frame_sequence import SPLITS, FrameSequence

_NAMES = "sequences.json"


@dataclass(frozen=True)
class _Named:
    """Row of `sequences.json` that describes a sequence."""

    name: str
    patient: str | None = None
    split: str | None = None


def folder_name(sequence: FrameSequence) -> str:
    """Name of a sequence as a single folder: `colon-0007_front`."""
    return sequence.name.replace("/", "_")


def each_folder(
    sequences: Sequence[FrameSequence], folder: Path
) -> Iterator[tuple[FrameSequence, Path]]:
    """Sequences with a new folder for each: by split, if there are splits."""
    for sequence in sequences:
        yield sequence, new_folder(folder, sequence.split, folder_name(sequence))


def each_rig(
    sequences: Sequence[FrameSequence], folder: Path
) -> Iterator[tuple[tuple[FrameSequence, ...], Path]]:
    """Sequences of the cameras of each capsule, with a new folder for each recording.

    A sequence without an episode is on its own.
    """
    for split, name, rig in recordings(sequences):
        yield rig, new_folder(folder, split, name)


def new_folder(folder: Path, split: str | None, name: str) -> Path:
    """Create the folder of a sequence, in that of its split if it has one.

    Raises:
        InputError: If it is the folder of another sequence, or lies outside.
    """
    place = inside(folder, f"{split}/{name}" if split else name)
    if place.exists():
        raise InputError(
            f"Two sequences would have the folder {place.name}. Export them one by one."
        )
    place.mkdir(parents=True)
    return place


def recordings(
    sequences: Sequence[FrameSequence],
) -> Iterator[tuple[str | None, str, tuple[FrameSequence, ...]]]:
    """Split and name of each recording, with the sequences of its cameras."""
    rigs: dict[tuple[str | None, str, str], list[FrameSequence]] = {}
    for sequence in sequences:
        episode = sequence.episode
        name = folder_name(sequence) if episode is None else episode.name
        source = sequence.name if episode is None else ""
        rigs.setdefault((sequence.split, name, source), []).append(sequence)
    for (split, name, _), rig in rigs.items():
        yield split, name, tuple(rig)


def found_folders(folder: Path, mark: str) -> Iterator[tuple[Path, str | None]]:
    """Sorted folders that hold a file of a name, with their split.

    Args:
        folder: One sequence, or a folder of sequences at any depth.
        mark: Path or pattern, from the sequence's folder, of a file that every sequence has.

    Raises:
        InputError: If there is none, or a link leads out of the folder.
    """
    found = listed(folder, f"**/{mark}")
    places = sorted({path.parents[mark.count("/")] for path in found})
    if not places:
        raise InputError(f"{folder} holds no {mark}, so no sequence in this layout.")
    for place in places:
        yield place, split_of(place, folder)


def split_of(place: Path, folder: Path) -> str | None:
    """Split of a sequence: the first folder on its path with the name of a split."""
    above = place.relative_to(folder).parts[:-1]
    return next((part for part in above if part in SPLITS), None)


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


def write_names(folder: Path, places: Mapping[str, FrameSequence]) -> None:
    """Write the names of sequences in a layout that numbers them; other readers ignore the file."""
    rows = {
        place: asdict(_Named(one.name, one.patient, one.split)) for place, one in places.items()
    }
    write_json(folder / _NAMES, rows)


def with_names(
    folder: Path, found: Iterable[tuple[str, FrameSequence]]
) -> tuple[FrameSequence, ...]:
    """Sequences with the names, patients and splits written by `write_names`.

    Raises:
        InputError: If the file of names is damaged; remove it to read without names.
    """
    path = folder / _NAMES
    if not path.exists():
        return tuple(sequence for _, sequence in found)
    rows = read_plain(path, "names")
    if not isinstance(rows, dict):
        raise InputError(f"{path} holds no table of names. Remove it to read without names.")
    return tuple(
        replace(sequence, **asdict(from_plain(_Named, rows[place], at=f"{path}: {place}")))
        if place in rows
        else sequence
        for place, sequence in found
    )
