"""Sources of frames: episodes, data sets, and folders in any known format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vrcaps.core.errors import InputError
from vrcaps.core.names import listed
from vrcaps.data.ledger import PLAN
from vrcaps.data.sequences import sequences_of
from vrcaps.formats.images import Images
from vrcaps.formats.read_format import read_format
from vrcaps.formats.registry import FORMATS
from vrcaps.formats.stored_images import IMAGES
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.layout import EPISODE_JSON


def read_source(text: str) -> tuple[FrameSequence, ...]:
    """Return the sequences of a source.

    Args:
        text: Folder or URL of an episode or a data set; a folder of images; or ``KIND:FOLDER`` for
            a folder in the format KIND of `vrcaps export`, such as ``c3vd:/data/c3vd``.

    Raises:
        InputError: If it cannot be read.
    """
    kind, colon, folder = text.partition(":")
    if colon and kind in FORMATS:
        return read_format(kind, folder)
    return read_format(Images.kind, text) if _holds_images(Path(text)) else sequences_of(text)


def _holds_images(folder: Path) -> bool:
    """Whether a folder has images or folders of them, and is not an episode or a data set."""
    if not folder.is_dir() or any((folder / name).exists() for name in (EPISODE_JSON, PLAN)):
        return False
    paths = (path for depth in ("*", "*/*") for path in listed(folder, depth))
    return any(path.suffix.lower() in IMAGES for path in paths)


def read_sources(texts: Sequence[str]) -> tuple[FrameSequence, ...]:
    """Return the sequences of all sources, see `read_source`.

    Raises:
        InputError: If there are none, or one cannot be read.
    """
    if not texts:
        raise InputError("There is no data. Give --data FOLDER, once or more.")
    return tuple(sequence for text in texts for sequence in read_source(text))
