"""Figure of an episode's coverage: organ seen and unseen, over time, and by segment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.units import CM
from vrcaps.mesh.mesh import wall_of
from vrcaps.metrics.coverage import COVERAGE_LEVELS
from vrcaps.tools.coverage.episode_coverage import EpisodeCoverage
from vrcaps.tools.coverage.write_coverage import vertex_level
from vrcaps.tools.overview.outside import VIEWS, outside_view
from vrcaps.tools.overview.unroll import unroll

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes

LEVEL_COLORS = np.array(
    [[0.80, 0.20, 0.20], [0.95, 0.70, 0.30], [0.55, 0.80, 0.45], [0.1, 0.6, 0.3]]
)
"""sRGB colors of the unseen wall and of the levels `visible`, `resolved` and `readable`."""

_CURVES = {"frustum": "#999999", "visible": "#e0982f", "resolved": "#7cb860", "readable": "#1a8a4a"}
_NAMES = ("not seen", *COVERAGE_LEVELS[1:])
_SIZE_INCH, _DPI = (13.0, 11.0), 110
_UNROLLED_PX = (180, 1200)


def write_coverage_figure(path: Path, found: EpisodeCoverage, *, title: str = "") -> None:
    """Draw the organ from two sides, its unrolled wall, coverage over time and by segment.

    Args:
        path: Image to write; its suffix determines the format.
        found: Coverage of an episode.
        title: Title above the figure.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    grid = figure.add_gridspec(3, 2, height_ratios=[1.5, 0.5, 0.8])
    organ = replace(found.organ, label=vertex_level(found).astype(np.uint8))
    wall = wall_of(organ.vertices, organ.faces)
    low, high = organ.vertices.min(axis=0), organ.vertices.max(axis=0)
    center, half = 0.5 * (low + high), 0.52 * float((high - low).max())
    for column, (name, axes) in enumerate(VIEWS.items()):
        view = figure.add_subplot(grid[0, column])
        view.imshow(outside_view(organ, wall, axes, center, half, colors=LEVEL_COLORS))
        view.set_axis_off()
        view.set_title(name, fontsize=10)
    _draw_unrolled(figure.add_subplot(grid[1, :]), organ, wall)
    _draw_over_time(figure.add_subplot(grid[2, 0]), found)
    _draw_segments(figure.add_subplot(grid[2, 1]), found)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=_DPI)


def _legend() -> list[Any]:
    from matplotlib.patches import Patch

    return [
        Patch(color=color, label=name) for color, name in zip(LEVEL_COLORS, _NAMES, strict=True)
    ]


def _draw_unrolled(view: Axes, organ: Any, wall: Any) -> None:
    """Draw the wall unrolled about the centerline, colored by level."""
    rows, columns = _UNROLLED_PX
    s = (np.arange(columns) + 0.5) / columns * organ.centerline.length
    theta = np.linspace(-np.pi, np.pi, rows)
    seen = unroll(organ, wall, s, theta)
    level = organ.label[organ.faces[seen.face]].max(axis=-1)
    image: Float[np.ndarray, "h w 3"] = LEVEL_COLORS[level] * (0.35 + 0.65 * seen.shade[..., None])
    image = np.where(seen.face[..., None] < 0, 0.93, image)
    ends = (0.0, organ.centerline.length / CM, -180.0, 180.0)
    view.imshow(image, extent=ends, origin="lower", aspect="auto")
    view.set_xlabel("distance from the oral end [cm]")
    view.set_ylabel("angle [°]")


def _draw_over_time(view: Axes, found: EpisodeCoverage) -> None:
    for level in COVERAGE_LEVELS:
        curve = 100.0 * found.over_time(level)
        view.plot(found.times, curve, color=_CURVES[level], label=f"{level}, {curve[-1]:.1f} %")
    view.set(xlabel="time [s]", ylabel="coverage [%]", ylim=(0, 100))
    view.grid(alpha=0.3)
    view.legend(frameon=False)


def _draw_segments(view: Axes, found: EpisodeCoverage) -> None:
    """Draw bars of each segment's coverage at the nested levels."""
    fractions = {level: found.by_segment(level) for level in COVERAGE_LEVELS[1:]}
    names = list(fractions["visible"])
    for number, by_name in enumerate(fractions.values(), start=1):
        values = [100.0 * by_name[name] for name in names]
        view.barh(names, values, color=LEVEL_COLORS[number])
    view.set(xlim=(0, 100), xlabel="coverage of the segment [%]")
    view.set_facecolor((*LEVEL_COLORS[0], 0.25))
    view.invert_yaxis()
