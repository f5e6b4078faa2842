"""Reading of data sets: splits, patients, recordings and frame sequences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from vrcaps.core.errors import UnknownNameError
from vrcaps.data.ledger import EPISODES, PLAN, complete_units, read_entry, read_plain_plan
from vrcaps.data.store import episode_files, open_store, read_at_once
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
        self, split: str | None = None, camera: str | None = None
    ) -> tuple[FrameSequence, ...]:
        """Return the frame sequences: one for each camera of each recording.

        The tables of all recordings are read immediately, images on demand.

        Raises:
            UnknownNameError: If there is no such split or camera.
        """
        groups = read_at_once(partial(Member.sequences, camera=camera), self.members(split))
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
    source: str | Path, *, camera: str | None = None, split: str | None = None
) -> tuple[FrameSequence, ...]:
    """Frame sequences of an episode or of the complete recordings of a data set.

    Args:
        source: Folder or URL of an episode or a data set.
        camera: Only the camera of this name; None takes all.
        split: Only this split of a data set; None takes all.

    Raises:
        InputError: If it holds neither.
        UnknownNameError: If there is no such camera or split.
    """
    store = open_store(source)
    try:
        store.read(PLAN)
    except OSError:
        return read_episode(episode_files(store)).sequences(camera)
    return open(source).sequences(split, camera)
