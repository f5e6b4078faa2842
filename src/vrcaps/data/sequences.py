"""The frame sequences of an episode or a data set: one for each camera of each recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from vrcaps.data.ledger import PLAN
from vrcaps.data.open_dataset import open_dataset
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.frame_sequence import FrameSequence


def sequences_of(
    source: str | Path, *, camera: str | None = None, split: str | None = None
) -> tuple[FrameSequence, ...]:
    """Sequences of an episode or of the whole recordings of a data set.

    Args:
        source: Folder of an episode or a data set.
        camera: Only the camera of this name; None takes all.
        split: Only this split of a data set; None takes all.

    Raises:
        InputError: If the folder holds neither.
        UnknownNameError: If there is no such camera or split.
    """
    if not (Path(source) / PLAN).exists():
        return _cameras_of(read_episode(source), camera)
    return tuple(
        replace(sequence, patient=str(member.patient), split=member.split)
        for member in open_dataset(source).members(split)
        for sequence in _cameras_of(member.read(), camera)
    )


def _cameras_of(episode: Episode, camera: str | None) -> tuple[FrameSequence, ...]:
    chosen = episode.cameras if camera is None else (episode.camera(camera),)
    return tuple(episode.sequence(one.name) for one in chosen)
