"""Reading of data sets: splits, patients, recordings, frame sequences, and their counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.data.ledger import ABOUT, EPISODES, PLAN, complete_units, read_entry, read_plain_plan
from vrcaps.data.store import Store, episode_files, open_store, read_at_once
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.frame_sequence import SPLITS, FrameSequence
from vrcaps.recording.layout import EpisodeFiles


@dataclass(frozen=True)
class Member:
    """Recording of a data set.

    Attributes:
        name: Name of its folder.
        patient: Index of the patient.
        split: `train`, `val` or `test`.
        files: Access to its files.
    """

    name: str
    patient: int
    split: str
    files: EpisodeFiles

    def read(self) -> Episode:
        """Open the episode; images are read on demand."""
        return read_episode(self.files)

    def sequences(self, camera: str | None = None) -> tuple[FrameSequence, ...]:
        """Return the frame sequence of each camera, or of the given one.

        Raises:
            UnknownNameError: If there is no such camera.
        """
        return tuple(
            replace(sequence, patient=str(self.patient), split=self.split)
            for sequence in self.read().sequences(camera)
        )


@dataclass(frozen=True)
class Dataset:
    """Complete recordings, by split and patient.

    Example:
        >>> dataset = vrcaps.data.open("s3://bucket/cohort")
        >>> for sequence in dataset.sequences("train"):
        ...     sequence[0]["rgb"], sequence[0]["T_world_camera"]

    Attributes:
        url: Folder or URL of the data set.
        plan: Plan of the data set.
        all_members: All recordings, by index.
    """

    url: str
    plan: dict[str, Any]
    all_members: tuple[Member, ...]

    def __len__(self) -> int:
        return len(self.all_members)

    def __iter__(self) -> Iterator[Member]:
        return iter(self.all_members)

    def members(self, split: str | None = None) -> tuple[Member, ...]:
        """Return the recordings of one split, or all.

        Raises:
            UnknownNameError: If there is no such split.
        """
        if split is not None and split not in SPLITS:
            raise UnknownNameError("split", split, SPLITS)
        return tuple(m for m in self.all_members if split in (None, m.split))

    def patients(self, split: str | None = None) -> tuple[int, ...]:
        """Indices of the patients of one split, or of all."""
        return tuple(sorted({member.patient for member in self.members(split)}))

    def sequences(
        self,
        split: str | None = None,
        camera: str | None = None,
        progress: ProgressReport = no_report,
    ) -> tuple[FrameSequence, ...]:
        """Return the frame sequences: one for each camera of each recording.

        The tables of all recordings are read immediately, images on demand.

        Args:
            split: Only this split; None takes all.
            camera: Name of the camera to read; None reads all.
            progress: Called with the number of read recordings and the total.

        Raises:
            UnknownNameError: If there is no such split or camera.
        """
        read = partial(Member.sequences, camera=camera)
        groups = read_at_once(read, self.members(split), progress)
        return tuple(sequence for sequences in groups for sequence in sequences)


def open(url: str | Path) -> Dataset:
    """Open a data set; only its plan and its ledger are read immediately.

    Incomplete units are left out.

    Args:
        url: Folder, or URL such as ``s3://bucket/cohort``.

    Raises:
        InputError: If there is no data set, or its ledger is damaged.
        MissingExtraError: If the package for this kind of URL is not installed.
    """
    store = open_store(url)
    plan = read_plain_plan(store)
    names = complete_units(store)
    entries = read_at_once(partial(read_entry, store), names)
    units = sorted(zip(names, entries, strict=True), key=lambda item: item[1]["number"])
    members = (
        Member(name, entry["patient"], entry["split"], episode_files(store, f"{EPISODES}/{name}"))
        for name, entry in units
    )
    return Dataset(store.url, plan, tuple(members))


def sequences_of(
    source: str | Path,
    *,
    camera: str | None = None,
    split: str | None = None,
    progress: ProgressReport = no_report,
) -> tuple[FrameSequence, ...]:
    """Frame sequences of an episode or of the complete recordings of a data set.

    Args:
        source: Folder or URL of an episode or a data set.
        camera: Name of the camera to read; None reads all.
        split: Split of the data set to read; None reads all.
        progress: Called with the number of read recordings of a data set and the total.

    Raises:
        InputError: If it holds neither.
        UnknownNameError: If there is no such camera or split.
    """
    store = open_store(source)
    try:
        store.read(PLAN)
    except OSError:
        return read_episode(episode_files(store)).sequences(camera)
    return open(source).sequences(split, camera, progress)


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
