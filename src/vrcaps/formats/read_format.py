"""Read a folder in the layout of others."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.formats.registry import format_named
from vrcaps.recording.frame_sequence import FrameSequence


def read_format(kind: str, folder: str | Path, **options: Any) -> tuple[FrameSequence, ...]:
    """Frame sequences of a folder in a layout of others; images are read when asked for.

    Frames are as those of an episode: meters, OpenCV camera axes, NaN where there is no value.

    Example:
        >>> for sequence in vrcaps.read_format("simcol3d", "SyntheticColon_I"):
        ...     sequence[0]["rgb"], sequence[0]["depth"], sequence[0]["T_world_camera"]

    Args:
        kind: Name of the layout, as of `vrcaps export`.
        folder: Where it lies.
        options: Of the layout, named as the options of `vrcaps export`.

    Raises:
        UnknownNameError: If there is no such layout or option.
        InputError: If the folder is not in this layout.
    """
    form = format_named(kind)
    known = [f.name for f in fields(form)]  # type: ignore[arg-type]
    for name in options:
        if name not in known:
            raise UnknownNameError(f"option of {kind}", name, known)
    if not Path(folder).is_dir():
        raise InputError(f"There is no folder {folder}.")
    return form(**options).read(Path(folder))
