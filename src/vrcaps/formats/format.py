"""Format protocol, and requirements of a format on the sequences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol

from vrcaps.camera.lens import AnyLens
from vrcaps.core.errors import InputError
from vrcaps.recording.frame_sequence import CAMERA_POSE, FrameSequence

if TYPE_CHECKING:
    from vrcaps.render.channels import Channel  # noqa: F401  (named in docstrings)

Advance = Callable[[], None]
"""Called after each written frame."""


@dataclass(frozen=True)
class Needs:
    """Requirements of a format.

    Attributes:
        channels: Image channels that every sequence must have.
        lenses: Lens models that it supports; None supports any.
        poses: Whether camera poses must be known.
        episode: Whether only episodes can be written, because it stores more than frames.
    """

    channels: tuple[str, ...] = ("rgb",)
    lenses: tuple[type, ...] | None = None
    poses: bool = True
    episode: bool = False


class Format(Protocol):
    """Layout of files that other tools read.

    A format is a frozen dataclass; its fields are the options of `vrcaps export KIND`.

    Attributes:
        kind: Name on the command line.
        needs: Requirements on the sequences.
    """

    kind: ClassVar[str]
    needs: ClassVar[Needs]

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write sequences into a new folder.

        Args:
            sequences: Sequences that meet `needs`.
            folder: Existing empty folder.
            advance: Called after each frame.
        """
        ...

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder in this layout; images are read on demand.

        Raises:
            InputError: If the folder is not in this layout.
        """
        ...


def require_needs(form: Format, sequences: Sequence[FrameSequence]) -> None:
    """Check that a format can hold sequences.

    Raises:
        InputError: If it cannot; the message says what is missing and what to do.
    """
    if not sequences:
        raise InputError("There is nothing to export: no recording fits what was asked for.")
    for sequence in sequences:
        _require_channels(form, sequence)
        _require_lens(form, sequence)
        if form.needs.poses and CAMERA_POSE not in sequence.values:
            raise InputError(f"{form.kind} needs poses of the camera; {sequence.name} has none.")
        if form.needs.episode and sequence.episode is None:
            raise InputError(
                f"{form.kind} holds more than frames; {sequence.name} is of no episode of vrcaps."
            )


def _require_channels(form: Format, sequence: FrameSequence) -> None:
    missing = [name for name in form.needs.channels if name not in sequence.channels]
    if missing:
        raise InputError(
            f"{form.kind} needs the channel {missing[0]!r}, which {sequence.name} has not. "
            f"Record with --channels {' '.join(dict.fromkeys((*sequence.channels, *missing)))}."
        )


def _require_lens(form: Format, sequence: FrameSequence) -> None:
    lenses = form.needs.lenses
    if lenses is None:
        return
    lens: AnyLens | None = None if sequence.camera is None else sequence.camera.lens
    if not isinstance(lens, lenses):
        has = "no camera" if lens is None else f"a lens of kind {lens.kind!r}"
        allowed = ", ".join(repr(one.kind) for one in lenses)
        raise InputError(
            f"{form.kind} holds lenses of kind {allowed}; {sequence.name} has {has}. "
            "Add --rectify DEGREES to resample to a pinhole of that field of view."
        )
