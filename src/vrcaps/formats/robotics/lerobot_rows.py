"""State, action and statistics of episodes, in the form of LeRobot's tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.motion.dynamics_columns import DYNAMICS_COLUMNS
from vrcaps.recording.sensing import pad_column_names
from vrcaps.recording.table import POSE_COLUMNS

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int

    from vrcaps.recording.episode import Episode

STATE, ACTION = "observation.state", "action"

_MAGNET_POSE = tuple(f"magnet_{name}" for name in POSE_COLUMNS)
_COMMANDED = tuple(name for name in DYNAMICS_COLUMNS if name.startswith("commanded_"))
_VELOCITY = (
    *(f"capsule_v{axis}_m_per_s" for axis in "xyz"),
    *(f"capsule_w{axis}_rad_per_s" for axis in "xyz"),
)
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
        if values.dtype.kind in "fiu" and name not in left_out and not name.startswith(of_cameras)
    ]
    return _rows(episode, names)


def action_rows(episode: Episode) -> Rows:
    """Action from each frame to the next; the last frame repeats its own row.

    With a steering magnet: pose of the magnet and joint angles of the arm at the next frame. With
    dynamics: mean commanded wrench until then, and insufflation. Otherwise: velocity of the
    capsule at the frame itself.
    """
    columns = episode.table.columns
    names = list(_MAGNET_POSE) if _MAGNET_POSE[0] in columns else []
    names += [name for name in columns if name.startswith("joint_")]
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
    found = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }
    return {name: row.tolist() for name, row in found.items()} | {"count": [len(values)]}


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
    share = histogram / histogram.sum(axis=1, keepdims=True)
    mean = share @ level
    found = {
        "min": [level[np.flatnonzero(row)[0]] for row in histogram],
        "max": [level[np.flatnonzero(row)[-1]] for row in histogram],
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ level**2 - mean**2, 0.0)),
    }
    for name, fraction in QUANTILES.items():
        found[name] = level[(share.cumsum(axis=1) >= fraction - 1e-12).argmax(axis=1)]
    shaped = {name: [[[float(x)]] for x in values] for name, values in found.items()}
    return shaped | {"count": [frames]}


def features_of(rows: Mapping[str, Rows]) -> dict[str, Any]:
    """Features of numeric columns, and those of every table, as in `info.json`."""
    found: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(own.names)], "names": list(own.names)}
        for name, own in rows.items()
    }
    for name, dtype in TABLE_COLUMNS.items():
        found[name] = {"dtype": dtype, "shape": [1], "names": None}
    return found


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
