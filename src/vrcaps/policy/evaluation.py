"""Evaluation on disk: a row for each episode, and its curves over time."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError
from vrcaps.core.files import write_bytes, write_csv
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS
from vrcaps.recording.table import FrameTable, read_table, write_table

if TYPE_CHECKING:
    from jaxtyping import Float

EPISODES, CURVES, SETTINGS = "episodes.csv", "curves.parquet", "settings.json"
PAPER_TIME = 47.62
"""Time at which VR-Caps reports its coverage [s] (Incetan et al., Med. Image Anal. 70, 2021)."""

PAPER_COVERAGE = 96.04
"""Coverage of VR-Caps at that time [%]."""

TARGETS = (90.0, 95.0, PAPER_COVERAGE)
"""Coverages whose times are reported [%]; the last is that of VR-Caps."""

FORCE_PERCENTILES = (50, 90, 99, 100)

POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class EpisodeCurves:
    """Curves of one episode over time: a row for the start and one for each action.

    Attributes:
        time: Time since the start of the episode [s].
        fraction: Fraction of the wall seen so far at each of `POINT_LEVELS`.
        arc_length: Position along the centerline [m].
        normal_force: Mean sum of the normal forces during the action [N].
        pose: Pose of the capsule in the world: position [m] and quaternion wxyz.
    """

    time: Float[np.ndarray, " t"]
    fraction: Float[np.ndarray, "t 3"]
    arc_length: Float[np.ndarray, " t"]
    normal_force: Float[np.ndarray, " t"]
    pose: Float[np.ndarray, "t 7"]

    def columns(self) -> dict[str, np.ndarray]:
        """Return the curves as columns of a table."""
        return {
            "time_s": self.time,
            **{level: self.fraction[:, k] for k, level in enumerate(POINT_LEVELS)},
            "arc_length_m": self.arc_length,
            "normal_force_n": self.normal_force,
            **{name: self.pose[:, k] for k, name in enumerate(POSE)},
        }


def reported_time(whole_time: float) -> float:
    """Time at which coverage is reported [s]: that of VR-Caps, or the end of shorter episodes."""
    return min(PAPER_TIME, whole_time)


def success_measures(
    curves: EpisodeCurves, progress: float, *, is_success: bool
) -> dict[str, float]:
    """Metrics of an episode's task.

    Args:
        curves: Curves of the episode.
        progress: Progress of the task at its end: maximum fraction of the path, the lesions or the
            wall.
        is_success: Whether the task was completed.

    Returns:
        Success (1 or 0), time to success [s] (NaN without success), progress in percent, and the
        length of the capsule's path [m].
    """
    way = np.linalg.norm(np.diff(curves.pose[:, :3], axis=0), axis=1).sum()
    return {
        "success": float(is_success),
        "time_to_success_s": float(curves.time[-1]) if is_success else np.nan,
        "progress_at_end": 100.0 * progress,
        "path_length_m": float(way),
    }


def episode_measures(curves: EpisodeCurves, whole_time: float) -> dict[str, float]:
    """Coverage and force metrics of an episode; after its end, its coverage stays constant.

    Args:
        curves: Curves of the episode.
        whole_time: Time over which the area under the curve is computed [s].

    Returns:
        Coverages and areas under the curve in percent; times in seconds, NaN if a coverage was
        not reached; percentiles of the normal force in newtons.
    """
    measures: dict[str, float] = {}
    report_time = reported_time(whole_time)
    for k, level in enumerate(POINT_LEVELS):
        percent = 100.0 * curves.fraction[:, k]
        measures[f"{level}_at_{report_time:g}_s"] = float(
            coverage_at(curves.time, percent, report_time)
        )
        measures[f"{level}_at_end"] = float(percent[-1])
        measures[f"{level}_area_under_curve"] = _mean_until(curves.time, percent, whole_time)
        for target in TARGETS:
            reached = np.flatnonzero(percent >= target - 1e-9)
            time = float(curves.time[reached[0]]) if len(reached) else np.nan
            measures[f"{level}_time_to_{target:g}_s"] = time
    forces = np.percentile(curves.normal_force[1:], FORCE_PERCENTILES)
    names = ("p50", "p90", "p99", "max")
    measures |= {f"force_{n}_n": float(f) for n, f in zip(names, forces, strict=True)}
    return measures


def coverage_at(
    time: Float[np.ndarray, " t"],
    percent: Float[np.ndarray, " t"],
    when: float | Float[np.ndarray, " k"],
) -> Float[np.ndarray, "*k"]:
    """Coverage reached by times [s]; the final one after the end."""
    return percent[np.maximum(np.searchsorted(time, when, side="right") - 1, 0)]


def _mean_until(
    time: Float[np.ndarray, " t"], percent: Float[np.ndarray, " t"], whole_time: float
) -> float:
    """Mean over a time [s] of values that stay constant until the next row."""
    edges = np.append(np.minimum(time, whole_time), whole_time)
    return float(np.diff(edges) @ percent / whole_time)


class Evaluation:
    """Folder of an evaluation; its files are complete whenever a run is interrupted."""

    def __init__(self, folder: Path, settings: dict[str, Any]) -> None:
        """Open or create the folder.

        Args:
            folder: Path of the folder.
            settings: Settings of the evaluation; plain values.

        Raises:
            InputError: If the folder contains an evaluation with other settings.
        """
        self.folder, self.settings = folder, settings
        self.rows: list[dict[str, Any]] = []
        self.curves: dict[str, np.ndarray] = {}
        folder.mkdir(parents=True, exist_ok=True)
        stated = folder / SETTINGS
        if stated.is_file():
            _require_same(stated, settings)
        else:
            text = json.dumps(settings, indent=1, sort_keys=True)
            write_bytes(stated, text.encode())
        if (folder / EPISODES).is_file() and (folder / CURVES).is_file():
            self.rows = read_rows(folder / EPISODES)
            self.curves = read_table(folder / CURVES).columns

    @property
    def done(self) -> set[tuple[int, int]]:
        """Seed and episode of each row."""
        return {(row["seed"], row["episode"]) for row in self.rows}

    def add(self, rows: list[dict[str, Any]], curves: list[EpisodeCurves]) -> None:
        """Add episodes and write both files, curves first, so that each row has its curves."""
        parts = [self.curves] if self.curves else []
        for row, curve in zip(rows, curves, strict=True):
            keys = {k: np.full(len(curve.time), row[k], np.int64) for k in ("seed", "episode")}
            parts.append(keys | curve.columns())
        self.curves = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
        write_table(self.folder / CURVES, FrameTable(self.curves))
        self.rows = sorted([*self.rows, *rows], key=lambda row: (row["seed"], row["episode"]))
        texts = [{k: _text(v) for k, v in row.items()} for row in self.rows]
        write_csv(self.folder / EPISODES, texts)

    def column(self, name: str) -> np.ndarray:
        """Values of one metric over all episodes."""
        return np.array([row[name] for row in self.rows])

    def episode_curves(self, row: dict[str, Any]) -> dict[str, np.ndarray]:
        """Curves of one episode; only the last copy is used if an interrupted run wrote two."""
        own = (self.curves["seed"] == row["seed"]) & (self.curves["episode"] == row["episode"])
        indices = np.flatnonzero(own)
        starts = np.flatnonzero(self.curves["time_s"][indices] == 0.0)
        indices = indices[starts[-1] :]
        return {name: values[indices] for name, values in self.curves.items()}

    def over_time(
        self, level: CoverageLevel, time: Float[np.ndarray, " t"]
    ) -> Float[np.ndarray, "n t"]:
        """Coverage of all episodes at times [s], in percent."""
        values = []
        for row in self.rows:
            curve = self.episode_curves(row)
            values.append(coverage_at(curve["time_s"], 100.0 * curve[level], time))
        return np.array(values)

    def median_row(self, name: str) -> dict[str, Any]:
        """Return the episode with the median value of a metric."""
        order = np.argsort(self.column(name), kind="stable")
        return self.rows[int(order[len(order) // 2])]


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Read the rows of an `episodes.csv`, with numeric values converted.

    Raises:
        InputError: If the file cannot be read.
    """
    try:
        with path.open(newline="") as file:
            return [{k: _value(v) for k, v in row.items()} for row in csv.DictReader(file)]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path} cannot be read ({error}). Delete it to start again.") from error


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _require_same(path: Path, settings: dict[str, Any]) -> None:
    before = decode_json(path.read_bytes(), path)
    if not isinstance(before, dict):
        raise InputError(f"{path} contains no table. Give a new folder.")
    plain = json.loads(json.dumps(settings))
    changed = [k for k in {**before, **plain} if before.get(k) != plain.get(k)]
    if changed:
        raise InputError(
            f"{path.parent} contains an evaluation with another {', '.join(sorted(changed))}. Give "
            "a new folder, or its original settings."
        )
