"""Frame as a standalone sample: images as files, all other data as plain values.

Images are files in the encodings of episodes: value = stored · scale + offset, and `invalid` where
there is no value; a sample describes them itself. Layouts that pack samples into large files share
this module.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError, reading
from vrcaps.formats.shared.folders import folder_name
from vrcaps.organ.surface import json_safe
from vrcaps.recording.frame_files import decode_image
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.layout import camera_from_plain, camera_to_plain, channel_to_plain
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

_OTHER = ("sequence", "index", "patient", "split", "camera", "label_names", "channels")
"""Keys of a sample that are not values of its frame."""

Location = Any
"""Storage location of an image in a layout."""


@dataclass(frozen=True)
class Sample:
    """Frame that was read: its plain values and the locations of its images."""

    plain: Mapping[str, Any]
    images: Mapping[str, Location]


def sample_key(sequence: FrameSequence, index: int) -> str:
    """Name of a sample, without dots: readers take the part after a dot as the file type."""
    return f"{folder_name(sequence).replace('.', '-')}_{index:06d}"


def require_unique_names(sequences: Sequence[FrameSequence]) -> None:
    """Check that samples of different sequences have different names.

    Raises:
        InputError: If two sequences have the same.
    """
    names: dict[str, str] = {}
    for sequence in sequences:
        key = sample_key(sequence, 0)
        if key in names:
            raise InputError(
                f"The samples of {names[key]} and {sequence.name} have the same names. "
                "Export them into separate folders."
            )
        names[key] = sequence.name


def by_split(sequences: Iterable[FrameSequence]) -> dict[str | None, list[FrameSequence]]:
    """Sequences of each split, in order."""
    splits: dict[str | None, list[FrameSequence]] = {}
    for sequence in sequences:
        splits.setdefault(sequence.split, []).append(sequence)
    return splits


def sample_images(sequence: FrameSequence, index: int) -> dict[str, bytes]:
    """Image files of a frame by channel; the same values give the same bytes."""
    stored = {
        channel: CHANNELS[channel].encoding.encode(sequence.image(channel, index))
        for channel in sequence.channels
    }
    pngs = [channel for channel in stored if suffix(channel) == ".png"]
    files = dict(zip(pngs, _core.encode_pngs([stored[name] for name in pngs]), strict=True))
    return {name: files[name] if name in files else _npy(stored[name]) for name in stored}


def sample_image(channel: str, data: bytes) -> NDArray:
    """Values of an image [h w] or [h w c] in SI units, given the bytes of its file.

    Raises:
        ValueError: If they are not such a file.
    """
    return CHANNELS[channel].encoding.decode(decode_image(data, suffix(channel)))


def suffix(channel: str) -> str:
    """Suffix of a channel's files."""
    return CHANNELS[channel].encoding.suffix


def sample_values(sequence: FrameSequence, index: int) -> dict[str, Any]:
    """All other data of a frame in JSON form: SI units, lens in pixels."""
    camera = None if sequence.camera is None else camera_to_plain(sequence.camera)
    return {
        "sequence": sequence.name,
        "index": index,
        "patient": sequence.patient,
        "split": sequence.split,
        **{name: json_safe(rows[index]) for name, rows in sequence.values.items()},
        "camera": camera,
        "label_names": list(sequence.label_names),
        "channels": {channel: channel_meaning(channel) for channel in sequence.channels},
    }


def channel_meaning(channel: str) -> dict[str, Any]:
    """Meaning of the values in a channel's files."""
    return {name: value for name, value in channel_to_plain(channel).items() if name != "path"}


def sequences_from(
    samples: Iterable[Sample], read: Callable[[Location], bytes], where: str
) -> tuple[FrameSequence, ...]:
    """Frame sequences from samples in any order; images are read on demand.

    Args:
        samples: All samples of a folder.
        read: Returns the bytes of an image at a location.
        where: The folder, for messages.

    Raises:
        InputError: If a sample lacks a required key.
    """
    groups: dict[str, list[Sample]] = {}
    for sample in samples:
        missing = [key for key in (*_OTHER, "time") if key not in dict(sample.plain)]
        if missing:
            raise InputError(
                f"A sample in {where} lacks {missing[0]!r}. Allowed: what vrcaps export writes."
            )
        groups.setdefault(sample.plain["sequence"], []).append(sample)
    if not groups:
        raise InputError(f"{where} contains no samples.")
    with reading(f"the samples in {where}, which do not fit together"):
        return tuple(_sequence(name, rows, read) for name, rows in groups.items())


def frames_of(sequences: Iterable[FrameSequence]) -> Iterator[tuple[FrameSequence, int]]:
    """All frames of some sequences, in order."""
    return ((sequence, index) for sequence in sequences for index in range(len(sequence)))


def _sequence(name: str, rows: list[Sample], read: Callable[[Location], bytes]) -> FrameSequence:
    rows = sorted(rows, key=lambda row: int(row.plain["index"]))
    first = rows[0].plain
    names = [key for key in first if key not in _OTHER]
    channels = tuple(channel for channel in CHANNELS if channel in rows[0].images)
    locations = {channel: [row.images[channel] for row in rows] for channel in channels}
    return FrameSequence(
        name,
        channels,
        {key: np.array([row.plain[key] for row in rows], float) for key in names},
        partial(_load, locations, read),
        None if first["camera"] is None else camera_from_plain(first["camera"], at="camera"),
        tuple(first["label_names"]),
        first["patient"],
        first["split"],
    )


def _load(
    locations: dict[str, list[Location]],
    read: Callable[[Location], bytes],
    channel: str,
    index: int,
) -> NDArray:
    location = locations[channel][index]
    try:
        return sample_image(channel, read(location))
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the image at {location}: {error}.") from error


def _npy(array: NDArray) -> bytes:
    data = io.BytesIO()
    np.save(data, array, allow_pickle=False)
    return data.getvalue()
