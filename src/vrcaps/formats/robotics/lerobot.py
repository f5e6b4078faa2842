"""LeRobot v3.0: episodes with states, actions and videos for imitation learning.

`data/` has a row per frame with `observation.state` and `action` from `frames.parquet` (with units
in the names), `videos/` a video per camera, `meta/` their description. Depth is z in the
camera frame [m], float32, NaN = no value, as the array `observation.depth.<camera>`: depth
videos, supported by newer readers, cannot encode missing values. `meta/vrcaps.json` keeps cameras,
patients and names; other readers ignore it. Layout: https://huggingface.co/docs/lerobot/lerobot-dataset-v3.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import write_bytes, write_json
from vrcaps.core.names import inside, listed
from vrcaps.formats.format import Needs
from vrcaps.formats.robotics.lerobot_read import read_dataset
from vrcaps.formats.robotics.lerobot_tables import (
    ACTION,
    DEPTH,
    EPISODES,
    IMAGES,
    INFO,
    NAMES,
    STATE,
    Rows,
    Statistics,
    action_rows,
    color_histogram,
    features_of,
    state_rows,
    task_of,
    write_episodes,
    write_frames,
    write_tasks,
)
from vrcaps.formats.shared.folders import recordings
from vrcaps.recording.frame_sequence import SPLITS, FrameSequence
from vrcaps.recording.layout import camera_to_plain
from vrcaps.recording.pictures import Preview

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.formats.format import Advance

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_CHUNK = 1000
_KEY_INTERVAL = 8
"""Key-frame interval of a video: frames are read in random order."""

_Cameras = tuple[FrameSequence, ...]


@dataclass(frozen=True)
class LeRobot:
    """LeRobot v3.0: videos with the states and actions of capsule and magnet.

    Recordings with different cameras, frame rates or columns become separate data sets, in folders
    named after their capsules.

    Attributes:
        images: Store images in the tables, as lossless PNG, instead of videos.
        crf: Constant rate factor of VP9 videos: 0 is best, 63 smallest.
        depth: Store depth, if it is recorded.
    """

    images: bool = False
    crf: Annotated[int, Range(0, 63)] = 20
    depth: bool = True

    kind: ClassVar[str] = "lerobot"
    needs: ClassVar[Needs] = Needs(poses=False, episode=True)

    def __post_init__(self) -> None:
        check_fields(self)

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write one data set, or one for each kind of recording."""
        groups: dict[Any, list[tuple[str | None, _Cameras]]] = {}
        for split, _, cameras in recordings(sequences):
            groups.setdefault(self._kind_of(cameras), []).append((split, cameras))
        names: list[str] = []
        for group in groups.values():
            stem = _episode(group[0][1]).head["capsule"]["name"]
            index = sum(name.startswith(stem) for name in names)
            names.append(f"{stem}-{index + 1}" if index else stem)
            root = inside(folder, names[-1]) if len(groups) > 1 else folder
            self._write_group(root, group, advance)

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of all data sets in a folder, also external ones; one per camera.

        Raises:
            InputError: If there is none, or a file is damaged.
        """
        roots = [path.parent.parent for path in listed(folder, f"**/{INFO}")]
        if not roots:
            raise InputError(f"{folder} contains no {INFO}, so it is not a LeRobot data set.")
        return tuple(sequence for root in roots for sequence in read_dataset(root))

    def _kind_of(self, cameras: _Cameras) -> Any:
        """Key of a data set: the same for all of its recordings."""
        return json.dumps([self._features(cameras), _episode(cameras).head["fps"]])

    def _features(self, cameras: _Cameras) -> dict[str, Any]:
        """Features of a kind of recording, as in `info.json`."""
        fps = _episode(cameras).head["fps"]
        features: dict[str, Any] = {}
        for sequence in cameras:
            camera = sequence.camera
            assert camera is not None
            size = [camera.height, camera.width]
            if self.images:
                image: dict[str, Any] = {"dtype": "image", "shape": [*size, 3]}
            else:
                # Video sizes are even.
                even = [side + side % 2 for side in size]
                image = {"dtype": "video", "shape": [*even, 3], "info": _film_info(even, fps)}
            features[f"{IMAGES}{camera.name}"] = {**image, "names": ["height", "width", "channels"]}
            if self.depth and "depth" in sequence.channels:
                depth = {"dtype": "float32", "shape": size, "names": ["height", "width"]}
                features[f"{DEPTH}{camera.name}"] = depth
        return features | features_of(_rows(cameras))

    def _write_group(
        self, root: Path, group: Sequence[tuple[str | None, _Cameras]], advance: Advance
    ) -> None:
        """Write a data set of recordings of one kind, in the order of their splits."""
        order = [*SPLITS, None]
        group = sorted(group, key=lambda item: order.index(item[0]))
        features = self._features(group[0][1])
        tasks = list(dict.fromkeys(task_of(_episode(cameras)) for _, cameras in group))
        collected, rows, frames = Statistics(), [], 0
        for number, (_, cameras) in enumerate(group):
            task = tasks.index(task_of(_episode(cameras)))
            episode = _Numbers(number, frames, task)
            histograms = self._write_images_and_rows(root, features, cameras, episode, advance)
            own = collected.add(_rows(cameras), histograms, len(cameras[0]))
            rows.append(_episode_row(episode, cameras, tasks[task], features, own))
            frames += len(cameras[0])
        write_episodes(root / EPISODES / f"{_file(0)}.parquet", rows)
        write_tasks(root / "meta/tasks.parquet", tasks)
        write_json(root / "meta/stats.json", collected.all())
        fps = _episode(group[0][1]).head["fps"]
        write_json(root / INFO, _info(features, group, frames, len(tasks), fps))
        write_json(root / NAMES, [_names(cameras) for _, cameras in group])

    def _write_images_and_rows(
        self,
        root: Path,
        features: Mapping[str, Any],
        cameras: _Cameras,
        episode: _Numbers,
        advance: Advance,
    ) -> dict[str, NDArray]:
        """Write the frames of an episode; return the color histogram of its images."""
        count, fps = len(cameras[0]), _episode(cameras).head["fps"]
        columns: dict[str, Any] = {
            **{name: own.values for name, own in _rows(cameras).items()},
            "timestamp": (np.arange(count) / fps).astype(np.float32),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, episode.index),
            "index": np.arange(count) + episode.first,
            "task_index": np.full(count, episode.task),
            "next.done": np.arange(count) == count - 1,
        }
        histograms = {}
        for sequence in cameras:
            assert sequence.camera is not None
            key = f"{IMAGES}{sequence.camera.name}"
            images = _Images(self, features[key], fps)
            depth: list[NDArray] = []
            for k in range(count):
                images.add(sequence.image("rgb", k))
                if self.depth and "depth" in sequence.channels:
                    depth.append(sequence.image("depth", k))
                advance()
            histograms[key] = images.histogram
            columns |= {key.replace(IMAGES, DEPTH): np.stack(depth)} if depth else {}
            if self.images:
                columns[key] = images.files
            else:
                path = root / "videos" / key / f"{_file(episode.index)}.mp4"
                path.parent.mkdir(parents=True, exist_ok=True)
                write_bytes(path, images.film())
        write_frames(root / "data" / f"{_file(episode.index)}.parquet", features, columns)
        return histograms


@dataclass(frozen=True)
class _Numbers:
    """Index of an episode, of its first frame in the data set, and of its task."""

    index: int
    first: int
    task: int


class _Images:
    """Images of a camera: a video being encoded, or files."""

    def __init__(self, form: LeRobot, feature: Mapping[str, Any], fps: float) -> None:
        height, width, _ = feature["shape"]
        self.files: list[dict[str, Any]] = []
        self.histogram = np.zeros((3, 256), np.int64)
        options = {"crf": form.crf, "key_interval": _KEY_INTERVAL}
        film = None if form.images else Preview(fps=fps, width=width, height=height, **options)
        self._film = film

    def add(self, rgb: NDArray) -> None:
        """Add a frame."""
        self.histogram += color_histogram(rgb)
        if self._film is not None:
            self._film.add([rgb])
            return
        (data,) = _core.encode_pngs([rgb])
        self.files.append({"bytes": data, "path": f"frame-{len(self.files):06d}.png"})

    def film(self) -> bytes:
        """Finish encoding and return the video file."""
        assert self._film is not None
        return self._film.finish()


def _rows(cameras: _Cameras) -> dict[str, Rows]:
    episode = _episode(cameras)
    states = state_rows(episode)
    if len(states.values) != len(cameras[0]):
        raise InputError(
            f"{cameras[0].name} has {len(cameras[0])} of the {len(states.values)} frames of "
            "its episode. Allowed for lerobot: all."
        )
    return {STATE: states, ACTION: action_rows(episode)}


def _episode(cameras: _Cameras) -> Any:
    episode = cameras[0].episode
    assert episode is not None
    return episode


def _file(index: int) -> str:
    """Path of the file of an episode."""
    return _FILE.format(chunk_index=index // _CHUNK, file_index=index % _CHUNK)


def _film_info(size: Sequence[int], fps: float) -> dict[str, Any]:
    return {
        "video.height": size[0],
        "video.width": size[1],
        "video.codec": "vp9",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": _whole(fps),
        "video.channels": 3,
        "has_audio": False,
    }


def _whole(fps: float) -> float:
    """Convert integral values to int, as readers expect."""
    return int(fps) if float(fps).is_integer() else fps


def _episode_row(
    episode: _Numbers,
    cameras: _Cameras,
    task: str,
    features: Mapping[str, Any],
    own: Mapping[str, Mapping[str, list]],
) -> dict[str, Any]:
    """Row of an episode in the table of episodes."""
    location = {"chunk_index": episode.index // _CHUNK, "file_index": episode.index % _CHUNK}
    frames = len(cameras[0])
    seconds = frames / _episode(cameras).head["fps"]
    row: dict[str, Any] = {
        "episode_index": episode.index,
        "tasks": [task],
        "length": frames,
        "dataset_from_index": episode.first,
        "dataset_to_index": episode.first + frames,
        **{f"data/{name}": index for name, index in location.items()},
        **{"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0},
    }
    for key in (name for name, feature in features.items() if feature["dtype"] == "video"):
        row |= {f"videos/{key}/{name}": index for name, index in location.items()}
        row |= {f"videos/{key}/from_timestamp": 0.0, f"videos/{key}/to_timestamp": seconds}
    for name, stats in own.items():
        row |= {f"stats/{name}/{key}": value for key, value in stats.items()}
    return row


def _info(
    features: Mapping[str, Any],
    group: Sequence[tuple[str | None, _Cameras]],
    frames: int,
    tasks: int,
    fps: float,
) -> dict[str, Any]:
    splits: dict[str, str] = {}
    names = [split or "train" for split, _ in group]
    for name in dict.fromkeys(names):
        first = names.index(name)
        splits[name] = f"{first}:{first + names.count(name)}"
    is_film = any(feature["dtype"] == "video" for feature in features.values())
    return {
        "codebase_version": "v3.0",
        "robot_type": _episode(group[0][1]).head["capsule"]["name"],
        "total_episodes": len(group),
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": _whole(fps),
        "splits": splits,
        "data_path": f"data/{_FILE}.parquet",
        "video_path": f"videos/{{video_key}}/{_FILE}.mp4" if is_film else None,
        "features": features,
    }


def _names(cameras: _Cameras) -> dict[str, Any]:
    """Metadata that other readers ignore."""
    return {
        "patient": cameras[0].patient,
        "split": cameras[0].split,
        "label_names": list(cameras[0].label_names),
        "cameras": {
            sequence.name: camera_to_plain(sequence.camera)
            for sequence in cameras
            if sequence.camera is not None
        },
    }
