"""Checkpoint of an interrupted recording: its motion and table."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError
from vrcaps.core.files import read_arrays, sync_folder, write_arrays, write_json
from vrcaps.motion.motion import MotionState
from vrcaps.recording.table import FrameTable, read_table, write_table

_FOLDER = ".resume"
_INDEX = "index.json"


@dataclass(frozen=True)
class Checkpoint:
    """State of a recording at a frame; this frame and all earlier ones are complete.

    Attributes:
        motion: The motion at the frame.
        table: Rows up to the frame.
    """

    motion: MotionState
    table: FrameTable


def write_checkpoint(episode: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint, replacing the previous one."""
    folder = episode / _FOLDER
    folder.mkdir(exist_ok=True)
    arrays, table = _paths(folder, checkpoint.motion.frame)
    write_arrays(arrays, checkpoint.motion.arrays)
    write_table(table, checkpoint.table)
    sync_folder(folder)  # the files exist before the index refers to them
    write_json(folder / _INDEX, {"frame": checkpoint.motion.frame})
    for path in folder.iterdir():
        if path not in (arrays, table, folder / _INDEX):
            path.unlink()


def read_checkpoint(episode: Path) -> Checkpoint | None:
    """Checkpoint of an interrupted recording; None if there is none.

    Raises:
        InputError: If its files are damaged.
    """
    folder = episode / _FOLDER
    if not (folder / _INDEX).exists():
        return None
    try:
        frame = int(decode_json((folder / _INDEX).read_bytes(), _INDEX)["frame"])
        path, table = _paths(folder, frame)
        return Checkpoint(MotionState(frame, read_arrays(path)), read_table(table))
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
