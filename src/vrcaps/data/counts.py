"""Counts of a data set: patients, recordings and frames, by any property of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from vrcaps.core.errors import InputError
from vrcaps.data.ledger import ABOUT, complete_units, read_entry
from vrcaps.data.store import Store, read_at_once
from vrcaps.recording.frame_sequence import SPLITS


@dataclass(frozen=True)
class Row:
    """Complete recording, as stored in the ledger.

    Attributes:
        name: Name of the unit.
        patient: Index of the patient.
        split: `train`, `val` or `test`.
        num_bytes: Size of its files.
        about: Summary of its contents, see `about_recording`.
        organ: Path and bytes of the organ's file if recordings share it; None if it has its own.
    """

    name: str
    patient: int
    split: str
    num_bytes: int
    about: Mapping[str, Any]
    organ: tuple[str, int] | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.about["frames"]


@dataclass(frozen=True)
class Count:
    """Size of a part of a data set.

    Attributes:
        patients: Number of patients.
        recordings: Number of recordings.
        frames: Number of frames.
        images: Number of images: one per frame and camera.
        seconds: Recorded time [s].
        num_bytes: Size of all files; shared organs count once.
    """

    patients: int
    recordings: int
    frames: int
    images: int
    seconds: float
    num_bytes: int


def rows_of(store: Store) -> list[Row]:
    """Return all complete recordings of a data set, in the order of the plan.

    Raises:
        InputError: If an entry of the ledger is damaged or lacks a summary of its recording.
    """
    names = complete_units(store)
    units = list(zip(names, read_at_once(partial(read_entry, store), names), strict=True))
    units.sort(key=lambda item: item[1]["number"])
    for name, entry in units:
        if ABOUT not in entry:
            raise InputError(
                f"{store.url}: the ledger's entry {name} is of an earlier version and lacks the "
                "summary of the recording. Make the data set again."
            )
    return [_row(name, entry) for name, entry in units]


def _row(name: str, entry: Mapping[str, Any]) -> Row:
    organ = entry.get("organ")
    stored = (organ["path"], organ["bytes"]) if organ else None
    return Row(name, entry["patient"], entry["split"], entry["bytes"], entry[ABOUT], stored)


def count(rows: Iterable[Row]) -> Count:
    """Count some recordings."""
    rows = list(rows)
    organs = [row.organ for row in rows if row.organ is not None]
    return Count(
        len({row.patient for row in rows}),
        len(rows),
        sum(row.frames for row in rows),
        sum(row.frames * len(row.about["cameras"]) for row in rows),
        sum(row.about["seconds"] for row in rows),
        sum(row.num_bytes for row in rows) + sum(dict(organs).values()),
    )


def count_by(rows: Sequence[Row], value: Callable[[Row], Any]) -> dict[Any, Count]:
    """Counts of recordings grouped by a value, most frames first."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(value(row), []).append(row)
    counts = {name: count(group) for name, group in groups.items()}
    return dict(sorted(counts.items(), key=lambda item: (-item[1].frames, str(item[0]))))


def by_split(rows: Sequence[Row]) -> dict[str, Count]:
    """Counts of each split, including empty ones."""
    return {name: count(row for row in rows if row.split == name) for name in SPLITS}


def lesion_counts(rows: Sequence[Row]) -> dict[str, tuple[int, int, int]]:
    """Lesions, patients and recordings of each kind of lesion, most lesions first.

    A lesion of a patient counts once, regardless of the number of recordings with it.
    """
    patients: dict[str, dict[int, int]] = {}
    recordings: dict[str, int] = {}
    for row in rows:
        kinds = list(row.about["lesions"])
        for kind in dict.fromkeys(kinds):
            counts = patients.setdefault(kind, {})
            counts[row.patient] = max(counts.get(row.patient, 0), kinds.count(kind))
            recordings[kind] = recordings.get(kind, 0) + 1
    totals = {
        kind: (sum(counts.values()), len(counts), recordings[kind])
        for kind, counts in patients.items()
    }
    return dict(sorted(totals.items(), key=lambda item: (-item[1][0], item[0])))


def segment_counts(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Frames with the capsule in each segment, by split; most frames first."""
    counts: dict[str, dict[str, int]] = {}
    for row in rows:
        for segment, frames in row.about["segments"].items():
            splits = counts.setdefault(segment, dict.fromkeys(SPLITS, 0))
            splits[row.split] += frames
    return dict(sorted(counts.items(), key=lambda item: (-sum(item[1].values()), item[0])))


def shared_organs(rows: Sequence[Row]) -> list[tuple[int, ...]]:
    """Groups of patients in different splits that have the same organ."""
    groups: dict[str, dict[int, str]] = {}
    for row in rows:
        groups.setdefault(row.about["organ_sha256"], {})[row.patient] = row.split
    shared = [group for group in groups.values() if len(set(group.values())) > 1]
    return [tuple(sorted(group)) for group in shared]
