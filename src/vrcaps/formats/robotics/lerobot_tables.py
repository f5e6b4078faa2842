"""Tables of LeRobot: states, actions and statistics of episodes, as Parquet."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.files import write_bytes
from vrcaps.motion.dynamics_settings import DYNAMICS_COLUMNS
from vrcaps.recording.sensing import pad_column_names
from vrcaps.recording.table import POSE_COLUMNS, open_parquet

if TYPE_CHECKING:
    import pyarrow as pa
    from jaxtyping import Float, Float32, Int
    from numpy.typing import NDArray

    from vrcaps.recording.episode import Episode

INFO, NAMES, EPISODES = "meta/info.json", "meta/vrcaps.json", "meta/episodes"
IMAGES, DEPTH = "observation.images.", "observation.depth."
STATE, ACTION = "observation.state", "action"

_MAGNET_POSE = tuple(f"magnet_{name}" for name in POSE_COLUMNS)
_COMMANDED = tuple(name for name in DYNAMICS_COLUMNS if name.startswith("commanded_"))
_VELOCITY = (
    *(f"capsule_v{axis}_m_per_s" for axis in "xyz"),
    *(f"capsule_w{axis}_rad_per_s" for axis in "xyz"),
)
_COIL_COMMAND = re.compile(r"coil_\d+_command_a")
_NO_STATE = ("frame", "time_s", "captured", *_COMMANDED)
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


@dataclass(frozen=True)
class Rows:
    """Named values of each frame of an episode; the names include the units.

    Attributes:
        names: Names of the columns.
        values: A row for each frame.
    """

    names: tuple[str, ...]
    values: Float32[np.ndarray, "n k"]


def state_rows(episode: Episode) -> Rows:
    """State at each frame: all numeric columns that always have a value.

    Camera poses are left out: they follow from the capsule pose and the mounts.
    """
    columns = episode.table.columns
    left_out = {*_NO_STATE, *pad_column_names(episode.scenario.sensors)}
    of_cameras = tuple(f"{camera.name}_" for camera in episode.cameras)
    names = [
        name
        for name, values in columns.items()
        if values.dtype.kind in "fiu"
        and not (name in left_out or _COIL_COMMAND.fullmatch(name) or name.startswith(of_cameras))
    ]
    return _rows(episode, names)


def action_rows(episode: Episode) -> Rows:
    """Action from each frame to the next; the last frame repeats its own row.

    With a steering magnet: pose of the magnet and joint angles of the arm at the next frame. With
    coils: their commanded currents. With dynamics: mean commanded wrench until then, and
    insufflation. Otherwise: velocity of the capsule at the frame itself.
    """
    columns = episode.table.columns
    names = list(_MAGNET_POSE) if _MAGNET_POSE[0] in columns else []
    names += [name for name in columns if name.startswith("joint_")]
    names += [name for name in columns if _COIL_COMMAND.fullmatch(name)]
    if _COMMANDED[0] in columns:
        names += [*_COMMANDED, "insufflation"]
    if not names:
        return _rows(episode, _VELOCITY)
    rows = _rows(episode, names)
    following = np.minimum(np.arange(1, len(episode) + 1), len(episode) - 1)
    return Rows(rows.names, rows.values[following])


def task_of(episode: Episode) -> str:
    """Task of an episode, in words."""
    organ, motion = episode.head["organ"]["name"], episode.scenario.motion.kind
    if _MAGNET_POSE[0] in episode.table.columns:
        return f"Steer the capsule through the {organ} with a magnet."
    ways = {
        "fly-through": f"Fly along the centerline of the {organ}.",
        "random-views": f"Look at the {organ} from many places.",
        "replay": f"Follow the given path through the {organ}.",
    }
    return ways.get(motion, f"Move the capsule through the {organ}.")


def statistics(values: Float[np.ndarray, "n k"]) -> dict[str, list]:
    """Statistics of columns over rows, as in `stats.json`."""
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=0)
    summary = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }
    return {name: row.tolist() for name, row in summary.items()} | {"count": [len(values)]}


def color_histogram(rgb: np.ndarray) -> Int[np.ndarray, "3 256"]:
    """Number of pixels of an image at each level of red, green and blue."""
    return np.stack([np.bincount(rgb[..., k].ravel(), minlength=256) for k in range(3)])


def color_statistics(histogram: Int[np.ndarray, "3 256"], frames: int) -> dict[str, list]:
    """Statistics of images with levels from 0 to 1, as in `stats.json`: 3×1×1.

    Args:
        histogram: Histogram of all images, from `color_histogram`.
        frames: Number of images.
    """
    level = np.arange(256) / 255.0
    fractions = histogram / histogram.sum(axis=1, keepdims=True)
    mean = fractions @ level
    summary = {
        "min": [level[np.flatnonzero(row)[0]] for row in histogram],
        "max": [level[np.flatnonzero(row)[-1]] for row in histogram],
        "mean": mean,
        "std": np.sqrt(np.maximum(fractions @ level**2 - mean**2, 0.0)),
    }
    for name, fraction in QUANTILES.items():
        summary[name] = level[(fractions.cumsum(axis=1) >= fraction - 1e-12).argmax(axis=1)]
    shaped = {name: [[[float(x)]] for x in values] for name, values in summary.items()}
    return shaped | {"count": [frames]}


def features_of(rows: Mapping[str, Rows]) -> dict[str, Any]:
    """Features of numeric columns, and those of every table, as in `info.json`."""
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(own.names)], "names": list(own.names)}
        for name, own in rows.items()
    }
    for name, dtype in TABLE_COLUMNS.items():
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
    return features


TABLE_COLUMNS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
    "next.done": "bool",
}
"""Columns of every frame table."""


def _rows(episode: Episode, names: Sequence[str]) -> Rows:
    columns = [episode.table.columns[name] for name in names]
    return Rows(tuple(names), np.stack(columns, axis=-1).astype(np.float32))


_PANDAS_INDEX = "__index_level_0__"
"""Column in which pandas stores row names."""


class Statistics:
    """Statistics of a data set, collected episode by episode."""

    def __init__(self) -> None:
        self._values: dict[str, list[NDArray]] = {}
        self._histograms: dict[str, NDArray] = {}
        self._frames = 0

    def add(
        self, rows: Mapping[str, Rows], histograms: Mapping[str, NDArray], frames: int
    ) -> dict[str, dict[str, list]]:
        """Add an episode; return its own statistics."""
        self._frames += frames
        for name, own in rows.items():
            self._values.setdefault(name, []).append(own.values)
        for name, own in histograms.items():
            self._histograms[name] = self._histograms.get(name, 0) + own
        colors = {name: color_statistics(own, frames) for name, own in histograms.items()}
        return {name: statistics(own.values) for name, own in rows.items()} | colors

    def all(self) -> dict[str, dict[str, list]]:
        """Return the statistics of all episodes."""
        summary = {name: statistics(np.concatenate(own)) for name, own in self._values.items()}
        for name, histogram in self._histograms.items():
            summary[name] = color_statistics(histogram, self._frames)
        return summary


def _arrow_kind(feature: Mapping[str, Any]) -> tuple[pa.DataType, dict[str, Any]]:
    """Type of a feature's column for Arrow and for Hugging Face.

    Args:
        feature: `dtype` and `shape`, as in `info.json`.
    """
    import pyarrow as pa

    if feature["dtype"] == "image":
        return pa.struct({"bytes": pa.binary(), "path": pa.string()}), {"_type": "Image"}
    kind = pa.type_for_alias(feature["dtype"])
    value, shape = {"dtype": feature["dtype"], "_type": "Value"}, feature["shape"]
    if shape == [1]:
        return kind, value
    if len(shape) == 1:
        sequence = {"feature": value, "length": shape[0], "_type": "Sequence"}
        return pa.list_(kind, shape[0]), sequence
    array = {"shape": list(shape), "dtype": feature["dtype"], "_type": "Array2D"}
    return pa.list_(pa.list_(kind)), array


def write_frames(
    path: Path, features: Mapping[str, Mapping[str, Any]], columns: Mapping[str, Any]
) -> None:
    """Write the frames of an episode.

    Args:
        path: Path of the file.
        features: Features of `info.json`; videos have no column.
        columns: Values of each feature.
    """
    import pyarrow as pa

    kinds = {name: _arrow_kind(one) for name, one in features.items() if one["dtype"] != "video"}
    about = {"info": {"features": {name: kind for name, (_, kind) in kinds.items()}}}
    schema = pa.schema(
        [(name, kind) for name, (kind, _) in kinds.items()], {"huggingface": json.dumps(about)}
    )
    arrays = [_array(columns[name], kinds[name][0]) for name in kinds]
    _write(path, pa.Table.from_arrays(arrays, schema=schema))


def write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks; pandas reads their strings as row names."""
    import pyarrow as pa

    text = {"pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    integer = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    about = {
        "index_columns": [_PANDAS_INDEX],
        "column_indexes": [
            {"name": None, "field_name": None, **text, "metadata": {"encoding": "UTF-8"}}
        ],
        "columns": [
            {"name": "task_index", "field_name": "task_index", **integer},
            {"name": None, "field_name": _PANDAS_INDEX, **text},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    fields = [("task_index", pa.int64()), (_PANDAS_INDEX, pa.string())]
    columns = {"task_index": range(len(tasks)), _PANDAS_INDEX: tasks}
    schema = pa.schema(fields, {"pandas": json.dumps(about)})
    _write(path, pa.table({name: list(values) for name, values in columns.items()}, schema))


def write_episodes(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a row for each episode."""
    import pyarrow as pa

    _write(path, pa.Table.from_pylist([dict(row) for row in rows]))


def read_table_rows(path: Path, names: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Rows of a table.

    Args:
        path: Path of the file.
        names: Names of the columns to read; None reads all.

    Raises:
        InputError: If it cannot be read.
    """
    with open_parquet(path, path) as file:
        return file.read(names).to_pylist()


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    """Arrow column; multi-dimensional arrays are not copied to Python lists."""
    import pyarrow as pa

    if not isinstance(values, np.ndarray) or values.ndim == 1:
        return pa.array(values, kind)
    flat = pa.array(np.ascontiguousarray(values).ravel())
    if values.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    count, height, width = values.shape
    rows = pa.ListArray.from_arrays(np.arange(count * height + 1, dtype=np.int32) * width, flat)
    return pa.ListArray.from_arrays(np.arange(count + 1, dtype=np.int32) * height, rows)


def _write(path: Path, table: pa.Table) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer, compression="zstd")
    write_bytes(path, buffer.getvalue().to_pybytes())
