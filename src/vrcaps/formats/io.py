"""Export of frame sequences, and readers of folders in a format and of sources in general."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, reading
from vrcaps.core.files import atomic_folder
from vrcaps.core.names import listed, require_links_inside
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.data.dataset import sequences_of
from vrcaps.data.ledger import PLAN
from vrcaps.data.store import read_at_once
from vrcaps.formats.format import FORMATS, Format, NamedByFolder, require_channels
from vrcaps.formats.shared.stored_images import IMAGES
from vrcaps.recording.frame_sequence import CAMERA_POSE, FrameSequence
from vrcaps.recording.layout import EPISODE_JSON


def export(
    form: Format,
    sequences: Sequence[FrameSequence],
    out: str | Path,
    *,
    progress: ProgressReport = no_report,
) -> Path:
    """Write sequences in a format; the folder appears when all files are written.

    Example:
        >>> episode = vrcaps.read_episode("runs/colon")
        >>> export(Tum(), [episode.sequence("front")], "runs/colon-tum")

    Args:
        form: Format with its options.
        sequences: Sequences to write; `sequences_of` returns those of an episode or a data set.
        out: Folder to create.
        progress: Called with the number of written frames and the total.

    Returns:
        The folder.

    Raises:
        InputError: If the format cannot hold them, the folder exists, or an image is damaged;
            no files remain.
    """
    require_needs(form, sequences)
    out = Path(out)
    total, done = sum(map(len, sequences)), 0

    def advance() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    if isinstance(form, NamedByFolder):
        form = form.for_folder(out)
    with atomic_folder(out) as partial:
        form.write(sequences, partial, advance)
    return out


def require_needs(form: Format, sequences: Sequence[FrameSequence]) -> None:
    """Check that a format can hold sequences.

    Raises:
        InputError: If it cannot; the message states the missing data and the remedy.
    """
    if not sequences:
        raise InputError("There is nothing to export: no recording matches the given options.")
    for sequence in sequences:
        require_channels(form.kind, sequence, form.needs.channels)
        _require_lens(form, sequence)
        if form.needs.poses and CAMERA_POSE not in sequence.values:
            raise InputError(f"{form.kind} requires camera poses; {sequence.name} has none.")
        if form.needs.episode and sequence.episode is None:
            raise InputError(
                f"{form.kind} stores more than frames; {sequence.name} is not of an episode of "
                "vrcaps. Export an episode or a data set."
            )


def _require_lens(form: Format, sequence: FrameSequence) -> None:
    lenses = form.needs.lenses
    lens = None if sequence.camera is None else sequence.camera.lens
    if lenses is None or (lens is not None and lens.kind in lenses):
        return
    given = "no camera" if lens is None else f"a lens of kind {lens.kind!r}"
    raise InputError(
        f"{form.kind} supports lenses of kind {', '.join(map(repr, lenses))}; {sequence.name} has "
        f"{given}. Add --rectify DEGREES to resample to a pinhole of that field of view."
    )


def read_format(kind: str, folder: str | Path, **options: Any) -> tuple[FrameSequence, ...]:
    """Return the frame sequences of a folder in an external format; images are read on demand.

    Frames have the conventions of an episode: meters, OpenCV camera axes, NaN for no value.

    Example:
        >>> for sequence in vrcaps.read_format("simcol3d", "SyntheticColon_I"):
        ...     sequence[0]["rgb"], sequence[0]["depth"], sequence[0]["T_world_camera"]

    Args:
        kind: Name of the format, as in `vrcaps export`.
        folder: Path of the folder.
        options: Options of the format, named as in `vrcaps export`.

    Raises:
        UnknownNameError: If there is no such format or option.
        InputError: If the folder is not in this format, a file in it is damaged, a file that it
            names lies outside, or a value is impossible (see `FrameSequence`).
    """
    form = FORMATS[kind]
    known = [f.name for f in fields(form)]  # type: ignore[arg-type]
    for name in options:
        if name not in known:
            raise UnknownNameError(f"option of {kind}", name, known)
    if not Path(folder).is_dir():
        raise InputError(f"The folder {folder} does not exist.")
    folder = Path(os.path.abspath(folder))  # "." has no name
    with reading(folder):
        require_links_inside(folder)
        sequences = form(**options).read(folder)
        for sequence in sequences:
            _require_rising_times(sequence)
    return sequences


def _require_rising_times(sequence: FrameSequence) -> None:
    times = sequence.times
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        k = int(wrong[0])
        raise InputError(
            f"{sequence.name}: frame {k + 1} at {times[k + 1]:.9g} s does not come after frame {k} "
            f"at {times[k]:.9g} s. Times must increase."
        )


def read_source(text: str, progress: ProgressReport = no_report) -> tuple[FrameSequence, ...]:
    """Return the sequences of a source.

    Args:
        text: Folder or URL of an episode or a data set; a folder of episodes or of images; or
            ``KIND:FOLDER`` for a folder in the format KIND of `vrcaps export`, such as
            ``c3vd:/data/c3vd``.
        progress: Called with the number of read recordings of a data set, or episodes of a folder,
            and the total.

    Raises:
        InputError: If it cannot be read.
    """
    kind, colon, path = text.partition(":")
    if colon and kind in FORMATS:
        return read_format(kind, path)
    folder = Path(text)
    if not folder.is_dir() or any((folder / name).exists() for name in (EPISODE_JSON, PLAN)):
        return sequences_of(text, progress=progress)
    if episodes := [head.parent for head in listed(folder, f"*/{EPISODE_JSON}")]:
        groups = read_at_once(sequences_of, episodes, progress)
        return tuple(sequence for sequences in groups for sequence in sequences)
    if not _holds_images(folder):
        raise InputError(
            f"{text} contains no images, episodes or data set. Allowed: a folder of images, with "
            f"the endings {', '.join(IMAGES)}, of an episode or a data set."
        )
    return read_format("images", text)


def _holds_images(folder: Path) -> bool:
    """Return whether a folder contains images."""
    paths = (path for depth in ("*", "*/*") for path in listed(folder, depth))
    return any(path.suffix.lower() in IMAGES for path in paths)


def read_sources(
    texts: Sequence[str], progress: ProgressReport = no_report
) -> tuple[FrameSequence, ...]:
    """Return the sequences of all sources, see `read_source`.

    Raises:
        InputError: If there are none, or one cannot be read.
    """
    if not texts:
        raise InputError("No data are given. Add --data FOLDER, once or more.")
    return tuple(sequence for text in texts for sequence in read_source(text, progress))
