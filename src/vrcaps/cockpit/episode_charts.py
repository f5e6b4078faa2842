"""Charts of episodes over time: speed, forces, clearance and the error of an estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.units import MM

if TYPE_CHECKING:
    import viser

    from vrcaps.cockpit.path_estimate import PathEstimate
    from vrcaps.recording.episode import Episode

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
    Column("gap to the wall [mm]", ("capsule_clearance_m",), lambda gap: gap / MM),
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
                shown = [np.interp(self._times, at, v, np.nan, np.nan) for v, at in lines]
                self._charts.append((self._add(column.title, shown, colors), shown))
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
