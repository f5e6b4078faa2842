"""LeRobot reader: videos and images of each camera of each episode."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.geometry import matrix_from_unit_quaternion, transform_from
from vrcaps.core.names import inside, listed
from vrcaps.formats.robotics.lerobot_tables import (
    DEPTH,
    EPISODES,
    IMAGES,
    INFO,
    NAMES,
    STATE,
    read_table_rows,
)
from vrcaps.formats.shared.stored_images import decoded_rgb
from vrcaps.recording.frame_files import require_pixels
from vrcaps.recording.frame_sequence import CAMERA_POSE, SPLITS, TIME, FrameSequence
from vrcaps.recording.layout import camera_from_plain
from vrcaps.recording.table import POSE_COLUMNS, open_parquet

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FIELD = re.compile(r"\{(\w+)(?::(0?\d?d))?\}")
"""Field of a template: its name and width."""
_CAPSULE = tuple(f"capsule_{name}" for name in POSE_COLUMNS)


def read_dataset(folder: Path) -> Iterator[FrameSequence]:
    """Frame sequence of each camera of each episode; images are read on demand.

    Raises:
        InputError: If a file is damaged.
    """
    info = read_plain(folder / INFO, "LeRobot")
    names = read_plain(folder / NAMES, "LeRobot") if (folder / NAMES).exists() else None
    paths = listed(folder, f"{EPISODES}/**/*.parquet")
    rows = [row for path in paths for row in read_table_rows(path)]
    if not rows or "features" not in info:
        raise InputError(f"{folder} has no episodes in {EPISODES} or no features in {INFO}.")
    for row in rows:
        index = row["episode_index"]
        own = None if names is None else names[index]
        try:
            yield from _sequences_of(folder, info, row, own)
        except (KeyError, TypeError, IndexError) as error:
            raise InputError(f"{folder}: episode {index} lacks {error}.") from error


def _sequences_of(
    folder: Path, info: Mapping[str, Any], row: Mapping[str, Any], own: Mapping[str, Any] | None
) -> Iterator[FrameSequence]:
    features = info["features"]
    location = {name: row[f"data/{name}"] for name in ("chunk_index", "file_index")}
    table = _file(folder, info["data_path"], location)
    columns = ["episode_index", "timestamp", *([STATE] if STATE in features else [])]
    frames = [
        {**frame, "row": k}
        for k, frame in enumerate(read_table_rows(table, columns))
        if frame["episode_index"] == row["episode_index"]
    ]
    values = {TIME: np.array([frame["timestamp"] for frame in frames], float)}
    capsule = _capsule_poses(features, frames)
    keys = [key for key, feature in features.items() if feature["dtype"] in ("video", "image")]
    for key in keys:
        camera_name = key.removeprefix(IMAGES)
        name, camera = f"episode-{row['episode_index']:06d}/{camera_name}", None
        more = dict(values)
        if own is not None:
            name = next(name for name in own["cameras"] if name.endswith(f"/{camera_name}"))
            camera = camera_from_plain(own["cameras"][name], at="camera")
            more[CAMERA_POSE] = capsule @ camera.T_capsule_camera
            more["T_world_capsule"] = capsule
        depth = f"{DEPTH}{camera_name}"
        yield FrameSequence(
            name,
            ("rgb", "depth") if depth in features else ("rgb",),
            more,
            partial(_load, folder, info, row, key, table, tuple(f["row"] for f in frames)),
            camera,
            tuple(own["label_names"]) if own else (),
            own["patient"] if own else None,
            own["split"] if own else _split_of(info, row["episode_index"]),
        )


def _capsule_poses(features: Mapping[str, Any], frames: list[dict[str, Any]]) -> NDArray:
    """``T_world_capsule`` [n 4 4] from the states; an empty array for external data."""
    names: list[str] = list(features.get(STATE, {}).get("names") or [])
    if not set(_CAPSULE) <= set(names):
        return np.zeros((0, 4, 4))
    columns = [names.index(name) for name in _CAPSULE]
    rows = np.array([[frame[STATE][k] for k in columns] for frame in frames], float)
    rotations = matrix_from_unit_quaternion(rows[:, 3:], STATE)
    return transform_from(rotations, rows[:, :3])


def _split_of(info: Mapping[str, Any], index: int) -> str | None:
    """Split of an episode: `splits` has ranges such as ``0:3``."""
    for name, text in info.get("splits", {}).items():
        first, _, end = str(text).partition(":")
        is_range = first.isdigit() and end.isdigit()
        if name in SPLITS and is_range and int(first) <= index < int(end):
            return name
    return None


def _load(
    folder: Path,
    info: Mapping[str, Any],
    row: Mapping[str, Any],
    key: str,
    table: Path,
    indices: tuple[int, ...],
    channel: str,
    index: int,
) -> NDArray:
    if channel == "depth":
        depth = _column(table, key.replace(IMAGES, DEPTH))[indices[index]].values.flatten()
        return depth.to_numpy().reshape(info["features"][key.replace(IMAGES, DEPTH)]["shape"])
    if info["features"][key]["dtype"] == "image":
        try:
            return decoded_rgb(_column(table, key)[indices[index]]["bytes"].as_py())
        except InputError as error:
            raise InputError(f"Cannot read image {index} of {key} in {table}: {error}.") from error
    location = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
    path = _file(folder, info["video_path"], {"video_key": key, **location})
    return _film_frame(path, row[f"videos/{key}/from_timestamp"] + index / info["fps"])


def _file(folder: Path, template: str, values: Mapping[str, Any]) -> Path:
    """Path from a template such as ``data/chunk-{chunk_index:03d}.parquet``.

    Raises:
        InputError: If the template is unsupported, or leads out of the folder.
    """
    try:
        name = _FIELD.sub(lambda field: f"{values[field[1]]:{field[2] or ''}}", template)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{folder / INFO} has the path {template!r}: {error}.") from error
    return inside(folder, name)


@lru_cache(maxsize=4)
def _column(path: Path, name: str) -> Any:
    with open_parquet(path, path) as file:
        return file.read([name]).column(0)


def _film_frame(path: Path, time: float) -> NDArray:
    """Video frame nearest to a time [s]."""
    av = import_extra("av", "formats")

    with reading(path), av.open(str(path)) as container:
        stream = container.streams.video[0]
        require_pixels(stream.width, stream.height)
        assert stream.time_base is not None
        step = 0.5 / float(stream.average_rate or 1)
        container.seek(int(time / stream.time_base), stream=stream)
        for frame in container.decode(stream):
            if frame.time is not None and frame.time > time - step:
                return frame.to_ndarray(format="rgb24")
    raise InputError(f"{path} has no frame at {time:.4f} s.")
