"""Frame sequences of an episode or a data set: one for each camera of each recording."""

from __future__ import annotations

from pathlib import Path

from vrcaps.data.dataset import open as open_dataset
from vrcaps.data.ledger import PLAN
from vrcaps.data.store import open_store
from vrcaps.data.stored_files import episode_files
from vrcaps.recording.episode import read_episode
from vrcaps.recording.frame_sequence import FrameSequence


def sequences_of(
    source: str | Path, *, camera: str | None = None, split: str | None = None
) -> tuple[FrameSequence, ...]:
    """Frame sequences of an episode or of the complete recordings of a data set.

    Args:
        source: Folder or URL of an episode or a data set.
        camera: Only the camera of this name; None takes all.
        split: Only this split of a data set; None takes all.

    Raises:
        InputError: If it holds neither.
        UnknownNameError: If there is no such camera or split.
    """
    store = open_store(source)
    try:
        store.read(PLAN)
    except OSError:
        return read_episode(episode_files(store)).sequences(camera)
    return open_dataset(source).sequences(split, camera)
