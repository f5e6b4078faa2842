"""Reader of a folder in an external format."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, reading
from vrcaps.core.names import require_links_inside
from vrcaps.formats.registry import format_named
from vrcaps.recording.frame_sequence import FrameSequence


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
    form = format_named(kind)
    known = [f.name for f in fields(form)]  # type: ignore[arg-type]
    for name in options:
        if name not in known:
            raise UnknownNameError(f"option of {kind}", name, known)
    if not Path(folder).is_dir():
        raise InputError(f"There is no folder {folder}.")
    folder = Path(os.path.abspath(folder))  # "." has no name
    with reading(folder):
        require_links_inside(folder)
        sequences = form(**options).read(folder)
        for sequence in sequences:
            _require_rising(sequence)
    return sequences


def _require_rising(sequence: FrameSequence) -> None:
    """Check that the times of frames increase.

    Raises:
        InputError: If they do not; the message names the frame.
    """
    times = sequence.times
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        k = int(wrong[0])
        raise InputError(
            f"{sequence.name}: frame {k + 1} at {times[k + 1]:.9g} s does not come after frame {k} "
            f"at {times[k]:.9g} s. Times must increase."
        )
