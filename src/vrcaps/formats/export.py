"""Write sequences in a format, atomically."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from vrcaps.core.files import atomic_folder
from vrcaps.formats.format import Format, require_needs
from vrcaps.recording.frame_sequence import FrameSequence


def export(
    form: Format,
    sequences: Sequence[FrameSequence],
    out: str | Path,
    *,
    progress: Callable[[int, int], None] | None = None,
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
        if progress is not None:
            progress(done, total)

    with atomic_folder(out) as partial:
        form.write(sequences, partial, advance)
    return out
