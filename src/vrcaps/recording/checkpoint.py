"""Where a simulation was when its recording was broken off, so that it goes on from there."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from vrcaps.errors import InputError
from vrcaps.files import atomic_write, write_json
from vrcaps.recording.table import FrameTable, read_table, write_table
from vrcaps.world.snapshot import Snapshot, read_snapshot, write_snapshot

_FOLDER = ".resume"
_INDEX = "index.json"


@dataclass(frozen=True)
class Checkpoint:
    """A simulation at a frame that is wholly written, as all before it are.

    Attributes:
        frame: Number of the frame.
        arc_length: Of the capsule along the gut, as the simulation follows it [m].
        snapshot: The world at the frame.
        table: Rows up to the frame.
    """

    frame: int
    arc_length: float
    snapshot: Snapshot
    table: FrameTable


def write_checkpoint(episode: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint in place of the one before."""
    folder = episode / _FOLDER
    folder.mkdir(exist_ok=True)
    world, table = _paths(folder, checkpoint.frame)
    with atomic_write(world) as temporary:
        write_snapshot(temporary, checkpoint.snapshot)
    write_table(table, checkpoint.table)
    write_json(folder / _INDEX, {"frame": checkpoint.frame, "arc_length_m": checkpoint.arc_length})
    for path in folder.iterdir():
        if path not in (world, table, folder / _INDEX):
            path.unlink()


def read_checkpoint(episode: Path) -> Checkpoint | None:
    """The checkpoint of a recording that was broken off; None where there is none.

    Raises:
        InputError: If its files are damaged.
    """
    folder = episode / _FOLDER
    if not (folder / _INDEX).exists():
        return None
    try:
        index = json.loads((folder / _INDEX).read_text(encoding="utf-8"))
        world, table = _paths(folder, index["frame"])
        snapshot, rows = read_snapshot(world), read_table(table)
        return Checkpoint(index["frame"], float(index["arc_length_m"]), snapshot, rows)
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InputError(
            f"{folder} is damaged ({error}). Delete it to simulate from the beginning; images that "
            "are there are kept."
        ) from error


def remove_checkpoint(episode: Path) -> None:
    """Delete what `write_checkpoint` wrote."""
    if (episode / _FOLDER).exists():
        shutil.rmtree(episode / _FOLDER)


def _paths(folder: Path, frame: int) -> tuple[Path, Path]:
    return folder / f"{frame:06d}.npz", folder / f"{frame:06d}.parquet"
