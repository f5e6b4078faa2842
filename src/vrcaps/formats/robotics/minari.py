"""Minari: recordings as episodes of states, actions and rewards for offline reinforcement learning.

Drives from the cockpit or the bridge, recorded by `vrcaps record`, and any other episode. Layout of
Minari's Arrow storage, written by Minari: https://minari.farama.org.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from vrcaps import __version__
from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.fields import check_fields
from vrcaps.core.names import is_dataset_id, require_dataset_id
from vrcaps.formats.format import Needs, require_channels
from vrcaps.formats.robotics.lerobot_tables import Rows, action_rows, state_rows, task_of
from vrcaps.formats.shared.folders import recordings
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.formats.format import Advance
    from vrcaps.recording.episode import Episode

_DEFAULT_ID = "vrcaps/recordings-v0"
_STATE = "state"
_REWARDS = {
    "progress": "distance of the capsule along the centerline towards the anal end [m]",
    "none": "0",
}
_Recording = tuple[str | None, str, tuple[FrameSequence, ...]]


@dataclass(frozen=True)
class Minari:
    """Minari data set: states, actions and rewards of drives and other recordings.

    Every recording is an episode whose last step is truncated. With `--out` in the folder of
    Minari's data sets, `minari.load_dataset` loads it by its path there.

    Attributes:
        dataset_id: Identifier in the metadata, with a version; if empty, it is the path of the
            output folder in Minari's folder, or elsewhere its last two parts or its name, such as
            vrcaps/drive-v0; vrcaps/recordings-v0 if these are not valid.
        images: Store the color images of all cameras as observations. Minari takes whole episodes:
            the longest recording needs 9 bytes of memory per pixel of its images.
        reward: Reward of a step: `progress`, the distance that the capsule moves along the
            centerline towards the anal end [m], or `none`, 0.
    """

    dataset_id: str = ""
    images: bool = False
    reward: Literal["progress", "none"] = "progress"

    kind: ClassVar[str] = "minari"
    needs: ClassVar[Needs] = Needs(channels=(), poses=False, episode=True)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.dataset_id:
            require_dataset_id(self.dataset_id)

    def for_folder(self, out: Path) -> Minari:
        """Return the data set with the identifier of an output folder, unless it has one."""
        return self if self.dataset_id else replace(self, dataset_id=_id_of(out))

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write one data set with an episode for each recording.

        Raises:
            InputError: If a recording has one frame, or other columns or cameras than the first.
            MissingExtraError: If Minari is not installed.
        """
        given = [*recordings(sequences)]
        self._require_one_kind(given)
        storage = _new_storage(folder / "data", self._spaces(given[0]))
        storage.update_metadata(self._metadata(given[0]))
        for recording in given:
            storage.update_episodes([self._buffer(recording)])
            for _ in range(sum(map(len, recording[2]))):
                advance()
        about = [{"recording": name, "split": split} for split, name, _ in given]
        storage.update_episode_metadata(about, range(len(given)))

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Reject reading: the data sets have no cameras.

        Raises:
            InputError: Always; it states the reader.
        """
        raise InputError(
            f"Minari data sets have no cameras, so {folder} is not a frame sequence. Read it by "
            f"minari.MinariDataset({str(folder / 'data')!r})."
        )

    def _cameras(self, recording: _Recording) -> tuple[FrameSequence, ...]:
        """Cameras whose images are stored."""
        return recording[2] if self.images else ()

    def _spaces(self, recording: _Recording) -> tuple[Any, Any]:
        """Observation and action space."""
        from gymnasium import spaces

        def unbounded(rows: Rows) -> Any:
            return spaces.Box(-np.inf, np.inf, (len(rows.names),), np.float32)

        episode = _episode(recording)
        space: dict[str, Any] = {_STATE: unbounded(state_rows(episode))}
        for sequence in self._cameras(recording):
            camera = sequence.camera
            assert camera is not None
            space[_image(sequence)] = spaces.Box(0, 255, (camera.height, camera.width, 3), np.uint8)
        return spaces.Dict(space), unbounded(action_rows(episode))

    def _metadata(self, recording: _Recording) -> dict[str, Any]:
        """Metadata of the data set, with the names and units of its values."""
        episode = _episode(recording)
        names = {_STATE: list(state_rows(episode).names)}
        names |= {_image(one): ["red", "green", "blue"] for one in self._cameras(recording)}
        return {
            "dataset_id": self.dataset_id or _DEFAULT_ID,
            "algorithm_name": "recorded",
            "description": f"{task_of(episode)} Recorded by vrcaps {__version__}.",
            "requirements": [f"vrcaps=={__version__}"],
            "minari_version": import_extra("minari", "robots").__version__,
            "observation_names": names,
            "action_names": list(action_rows(episode).names),
            "reward": _REWARDS[self.reward],
        }

    def _require_one_kind(self, given: Sequence[_Recording]) -> None:
        for recording in given:
            if len(_episode(recording)) < 2:
                raise InputError(
                    f"{recording[1]} has 1 frame. A Minari data set requires 2 or more."
                )
        first = self._layout(given[0])
        for recording in given[1:]:
            if self._layout(recording) != first:
                raise InputError(
                    f"{recording[1]} has other columns or cameras than {given[0][1]}. Export "
                    "recordings of one kind into a data set."
                )

    def _buffer(self, recording: _Recording) -> Any:
        """Episode in Minari's form."""
        collector = import_extra("minari.data_collector", "robots", package="minari")
        episode = _episode(recording)
        observations = {_STATE: state_rows(episode).values}
        for sequence in self._cameras(recording):
            assert sequence.camera is not None
            shape = (len(sequence), sequence.camera.height, sequence.camera.width, 3)
            images = observations[_image(sequence)] = np.empty(shape, np.uint8)
            for k in range(len(sequence)):
                images[k] = sequence.image("rgb", k)
        steps = len(episode) - 1
        return collector.EpisodeBuffer(
            observations=observations,
            actions=action_rows(episode).values[:-1],
            rewards=self._rewards(episode).tolist(),
            terminations=[False] * steps,
            truncations=[False] * (steps - 1) + [True],
        )

    def _layout(self, recording: _Recording) -> tuple[Any, ...]:
        episode = _episode(recording)
        cameras = self._cameras(recording)
        for sequence in cameras:
            require_channels(self.kind, sequence, ("rgb",))
        sizes = [(one.name, one.height, one.width) for one in (s.camera for s in cameras) if one]
        return (state_rows(episode).names, action_rows(episode).names, sizes)

    def _rewards(self, episode: Episode) -> Float[np.ndarray, " s"]:
        if self.reward == "none":
            return np.zeros(len(episode) - 1)
        return np.diff(episode.table.columns["arc_length_m"])


def _id_of(out: Path) -> str:
    """Identifier of a data set in a folder; Minari lists it only if it is the path in its folder.

    Outside Minari's folder a parent named `datasets` is taken for one.
    """
    out = Path(os.path.abspath(out))
    root = os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets"
    root = Path(os.path.abspath(root))
    if out.is_relative_to(root):
        candidates = [out.relative_to(root).as_posix()]
    else:
        pair = [] if out.parent.name == "datasets" else ["/".join(out.parts[-2:])]
        candidates = [*pair, out.name]
    return next(filter(is_dataset_id, candidates), _DEFAULT_ID)


def _new_storage(path: Path, spaces: tuple[Any, Any]) -> Any:
    storage = import_extra("minari.dataset.minari_storage", "robots", package="minari")
    path.mkdir(parents=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return storage.MinariStorage.new(path, *spaces, data_format="arrow", jpeg_encoding=False)


def _episode(recording: _Recording) -> Episode:
    episode = recording[2][0].episode
    assert episode is not None
    return episode


def _image(sequence: FrameSequence) -> str:
    assert sequence.camera is not None
    return f"image_{sequence.camera.name}"
