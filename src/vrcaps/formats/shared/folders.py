"""Folders of sequences, and their frames: created, located, in numeric order, read on demand."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_json
from vrcaps.core.names import inside, listed
from vrcaps.formats.shared.stored_images import IMAGES
from vrcaps.recording.frame_sequence import SPLITS, FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NAMES = "sequences.json"
_NUMBER = re.compile(r"\d+")

Reader = Callable[[Path], "NDArray"]
"""Reader of the image of one channel in SI units."""


@dataclass(frozen=True)
class _Named:
    """Row of `sequences.json` that describes a sequence."""

    name: str
    patient: str | None = None
    split: str | None = None


def folder_name(sequence: FrameSequence) -> str:
    """Name of a sequence as a single folder: `colon-0007_front`."""
    return sequence.name.replace("/", "_")


def sequence_folders(
    sequences: Sequence[FrameSequence], folder: Path
) -> Iterator[tuple[FrameSequence, Path]]:
    """Sequences with a new folder for each: by split, if there are splits."""
    for sequence in sequences:
        yield sequence, new_folder(folder, sequence.split, folder_name(sequence))


def rig_folders(
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
    path = inside(folder, f"{split}/{name}" if split else name)
    if path.exists():
        raise InputError(f"Two sequences require the folder {path.name}. Export them one by one.")
    path.mkdir(parents=True)
    return path


def recordings(
    sequences: Sequence[FrameSequence],
) -> Iterator[tuple[str | None, str, tuple[FrameSequence, ...]]]:
    """Split and name of each recording, with the sequences of its cameras."""
    rigs: dict[tuple[str | None, str, str], list[FrameSequence]] = {}
    for sequence in sequences:
        episode = sequence.episode
        name = folder_name(sequence) if episode is None else episode.name
        source = sequence.name if episode is None else episode.url
        rigs.setdefault((sequence.split, name, source), []).append(sequence)
    for (split, name, _), rig in rigs.items():
        yield split, name, tuple(rig)


def find_folders(folder: Path, mark: str) -> Iterator[tuple[Path, str | None]]:
    """Sorted folders that contain a file with a given name, with their split.

    Args:
        folder: One sequence, or a folder of sequences at any depth.
        mark: Path or pattern, from the sequence's folder, of a file that every sequence has.

    Raises:
        InputError: If there is none, or a link leads out of the folder.
    """
    marked = listed(folder, f"**/{mark}")
    roots = sorted({path.parents[mark.count("/")] for path in marked})
    if not roots:
        raise InputError(f"{folder} contains no {mark}, so it is not a sequence in this layout.")
    for root in roots:
        yield root, split_of(root, folder)


def split_of(root: Path, folder: Path) -> str | None:
    """Split of a sequence: the first folder on its path with the name of a split."""
    above = root.relative_to(folder).parts[:-1]
    return next((part for part in above if part in SPLITS), None)


def write_names(folder: Path, sequences: Mapping[str, FrameSequence]) -> None:
    """Write the names of sequences in a layout that numbers them; other readers ignore the file."""
    rows = {key: asdict(_Named(one.name, one.patient, one.split)) for key, one in sequences.items()}
    write_json(folder / _NAMES, rows)


def with_names(
    folder: Path, sequences: Iterable[tuple[str, FrameSequence]]
) -> tuple[FrameSequence, ...]:
    """Sequences with the names, patients and splits written by `write_names`.

    Raises:
        InputError: If the file of names is damaged; remove it to read without names.
    """
    path = folder / _NAMES
    if not path.exists():
        return tuple(sequence for _, sequence in sequences)
    rows = read_plain(path, "names")
    if not isinstance(rows, dict):
        raise InputError(f"{path} contains no table of names. Remove it to read without names.")
    return tuple(
        replace(sequence, **asdict(from_plain(_Named, rows[key], at=f"{path}: {key}")))
        if key in rows
        else sequence
        for key, sequence in sequences
    )


def nearest_file(folder: Path, top: Path, *patterns: str) -> Path | None:
    """First file that matches a pattern, in a folder or its parents up to `top`."""
    current = folder.resolve()
    last = top.resolve().parent
    while True:
        for pattern in patterns:
            paths = listed(current, pattern)
            if paths:
                return paths[0]
        if current in (last, current.parent):
            return None
        current = current.parent


def by_number(paths: Iterable[Path]) -> dict[int, Path]:
    """Files by the last number in their names, in numeric order: 10 after 9 without leading zeros.

    Raises:
        InputError: If a name has no number, or two have the same.
    """
    files: dict[int, Path] = {}
    for path in paths:
        indices = _NUMBER.findall(path.stem)
        if not indices:
            raise InputError(f"{path} has no frame number in its name.")
        if files.setdefault(int(indices[-1]), path) != path:
            raise InputError(f"{path} and {files[int(indices[-1])].name} have the same number.")
    return dict(sorted(files.items()))


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
    for name, files in channels.items():
        if not files:
            continue
        missing = [number for number in frames if number not in files]
        if missing:
            raise InputError(
                f"{frames[missing[0]]} and {len(missing) - 1} more frames lack a file of {name}. "
                f"Add the files, or remove all of {name}."
            )
        paths[name] = [files[number] for number in frames]
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
