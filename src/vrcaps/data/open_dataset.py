"""Read a data set: its splits, patients and episodes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vrcaps.data.ledger import EPISODES, PLAN, entries
from vrcaps.data.plan import SPLITS
from vrcaps.data.store import LocalStore
from vrcaps.errors import InputError, UnknownNameError
from vrcaps.recording.episode import Episode, read_episode


@dataclass(frozen=True)
class Member:
    """One recording of a data set.

    Attributes:
        name: Of its folder.
        patient: Number of the patient.
        split: `train`, `val` or `test`.
        path: Its folder.
    """

    name: str
    patient: int
    split: str
    path: Path

    def read(self) -> Episode:
        """The episode; images are read when asked for."""
        return read_episode(self.path)


@dataclass(frozen=True)
class Dataset:
    """Recordings that are whole, by split and patient.

    Example:
        >>> dataset = vrcaps.open_dataset("runs/cohort")
        >>> for member in dataset.members("train"):
        ...     episode = member.read()

    Attributes:
        path: Its folder.
        plan: What it was made of.
        all_members: Its recordings, by number.
    """

    path: Path
    plan: dict[str, Any]
    all_members: tuple[Member, ...]

    def __len__(self) -> int:
        return len(self.all_members)

    def __iter__(self) -> Iterator[Member]:
        return iter(self.all_members)

    def members(self, split: str | None = None) -> tuple[Member, ...]:
        """Recordings of one split, or all.

        Raises:
            UnknownNameError: If there is no such split.
        """
        if split is not None and split not in SPLITS:
            raise UnknownNameError("split", split, SPLITS)
        return tuple(m for m in self.all_members if split in (None, m.split))

    def patients(self, split: str | None = None) -> tuple[int, ...]:
        """Numbers of the patients of one split, or all."""
        return tuple(sorted({member.patient for member in self.members(split)}))


def open_dataset(path: str | Path) -> Dataset:
    """Open a data set; only its plan and its ledger are read at once.

    Units that are not whole are left out.

    Raises:
        InputError: If the folder holds no data set, or its ledger is damaged.
    """
    folder = Path(path)
    store = LocalStore(folder)
    try:
        plan = json.loads(store.read(PLAN))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder} holds no data set ({error}). Give the --out of `vrcaps dataset make`."
        ) from error
    found = sorted(entries(store).items(), key=lambda item: item[1]["number"])
    members = (
        Member(name, entry["patient"], entry["split"], folder / EPISODES / name)
        for name, entry in found
    )
    return Dataset(folder, plan, tuple(members))
