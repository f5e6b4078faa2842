"""Charts of episodes over time: speed, forces, clearance and the error of an estimated path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.metrics.trajectory import TrajectoryAlignment, aligned_poses
from vrcaps.motion.replay import read_tum
from vrcaps.motion.trajectory import resample

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float, Int

    from vrcaps.recording.episode import Episode

ALIGNMENTS: dict[str, TrajectoryAlignment] = {
    "none": "none",
    "rigid": "se3",
    "rigid and scale": "sim3",
}
"""Alignments to the true path, by their names in the page."""


@dataclass(frozen=True)
class PathEstimate:
    """Estimated and true poses at the frames of an episode that the estimate covers.

    Attributes:
        frames: Indices of these frames, ascending.
        estimated: Estimated ``T_world_capsule``.
        true: True ``T_world_capsule``.
    """

    frames: Int[np.ndarray, " k"]
    estimated: Float[np.ndarray, "k 4 4"]
    true: Float[np.ndarray, "k 4 4"]

    def aligned(self, align: TrajectoryAlignment) -> PathEstimate:
        """Align the estimate to the true path (Umeyama, TPAMI 13(4), 1991).

        Raises:
            InputError: If the positions do not determine a rotation.
        """
        return PathEstimate(self.frames, aligned_poses(self.estimated, self.true, align), self.true)

    @property
    def errors(self) -> Float[np.ndarray, " k"]:
        """Distance of each estimated position from the true one [m]."""
        return np.linalg.norm(self.estimated[:, :3, 3] - self.true[:, :3, 3], axis=1)

    def index_of(self, frame: int) -> int | None:
        """Index of a frame in `frames`; None if the estimate does not cover it."""
        index = int(np.searchsorted(self.frames, frame))
        return index if index < len(self.frames) and self.frames[index] == frame else None


def read_path_estimate(path: Path, episode: Episode) -> PathEstimate:
    """Read an estimated path from a TUM file, in meters, at the times of an episode's frames.

    Raises:
        InputError: If the file cannot be read or covers fewer than two frames.
    """
    given = read_tum(path, unit="m")
    first, last, times = given.times[0], given.times[-1], episode.times
    frames = np.flatnonzero((times >= first) & (times <= last))
    if len(frames) < 2:
        raise InputError(
            f"{path} covers {first:g} s to {last:g} s, the episode {times[0]:g} s to "
            f"{times[-1]:g} s. Give each pose the time of its frame, as frames.parquet has it."
        )
    poses = resample(given, times[frames]).Ts_world_capsule
    return PathEstimate(frames, poses, episode.Ts_world_capsule[frames])


_HEIGHT = 130
_NOW = "#f8f9fa"


@dataclass(frozen=True)
class Column:
    """Quantity of an episode in a chart.

    Attributes:
        title: Title with unit.
        needs: Table columns that it is computed from.
        of: Computes its values from these columns.
    """

    title: str
    needs: tuple[str, ...]
    of: Callable[..., np.ndarray]


def _size(*parts: np.ndarray) -> np.ndarray:
    return np.linalg.norm(parts, axis=0)


COLUMNS = (
    Column(
        "speed [mm/s]",
        tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz"),
        lambda *parts: _size(*parts) / MM,
    ),
    Column("clearance to the wall [mm]", ("capsule_clearance_m",), lambda gap: gap / MM),
    Column("contact force [mN]", ("normal_force_total_n",), lambda force: 1e3 * force),
    Column(
        "magnetic force [mN]",
        tuple(f"magnetic_force_{axis}_n" for axis in "xyz"),
        lambda *parts: 1e3 * _size(*parts),
    ),
    Column("angle to the field [°]", ("coupling_angle_rad",), np.rad2deg),
    Column("insufflation [1]", ("insufflation",), lambda factor: factor),
)
"""Charts from top to bottom; an episode has those whose columns it contains."""


class EpisodeCharts:
    """Charts over the time of the first episode, with a line for each episode."""

    def __init__(
        self, gui: viser.GuiApi, episodes: Sequence[Episode], colors: Sequence[str]
    ) -> None:
        """Add the charts whose columns an episode contains.

        Args:
            gui: Parent of the charts.
            episodes: One or two episodes.
            colors: Colors of their lines.
        """
        self._gui, self._times = gui, episodes[0].times
        self._charts: list[tuple[Any, list[np.ndarray]]] = []
        for column in COLUMNS:
            lines = [(values_of(column, episode), episode.times) for episode in episodes]
            if not all(np.isnan(values).all() for values, _ in lines):
                resampled = [np.interp(self._times, at, v, np.nan, np.nan) for v, at in lines]
                self._charts.append((self._add(column.title, resampled, colors), resampled))
        self._error: Any = None

    def show_error(self, estimate: PathEstimate, color: str) -> None:
        """Add or update the chart of an estimate's error."""
        errors = np.full(len(self._times), np.nan)
        errors[estimate.frames] = estimate.errors / MM
        if self._error is None:
            self._error = self._add("error of the estimate [mm]", [errors], (color,))
            self._charts.append((self._error, [errors]))
        else:
            self._charts[-1] = (self._error, [errors])

    def mark(self, frame: int) -> None:
        """Mark a frame of the first episode in all charts."""
        for chart, lines in self._charts:
            chart.data = (self._times, *lines, _marked(lines[0], frame))

    def _add(self, title: str, lines: list[np.ndarray], colors: Sequence[str]) -> Any:
        from viser import uplot

        drawn = [
            uplot.Series(label=title, stroke=color, width=1.5)
            for _, color in zip(lines, colors, strict=False)
        ]
        now = uplot.Series(
            label="now", stroke=_NOW, points=uplot.Series_Points(show=True, size=9.0)
        )
        return self._gui.add_uplot(
            (self._times, *lines, _marked(lines[0], 0)),
            (uplot.Series(label="s"), *drawn, now),
            title=title,
            height=_HEIGHT,
            scales={"x": uplot.Scale(time=False)},
            legend=uplot.Legend(show=False),
        )


def values_of(column: Column, episode: Episode) -> np.ndarray:
    """Values of a column at each frame; NaN where the episode has none."""
    table = episode.table.columns
    if not table.keys() >= set(column.needs):
        return np.full(len(episode.times), np.nan)
    return np.asarray(column.of(*(table[name] for name in column.needs)), float)


def _marked(values: np.ndarray, frame: int) -> np.ndarray:
    """All NaN except for the value of a frame."""
    marked = np.full(len(values), np.nan)
    marked[frame] = values[frame]
    return marked
