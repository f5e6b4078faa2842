"""`vrcaps coverage`: coverage of an organ by an episode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.paths import require_folder
from vrcaps.core.units import MM
from vrcaps.metrics.coverage import COVERAGE_LEVELS, CoverageCriteria

if TYPE_CHECKING:
    from vrcaps.tools.reports.coverage import EpisodeCoverage

COVERAGE_FOLDER = "coverage"
TABLE, MESH, FIGURE = "coverage.parquet", "coverage.glb", "coverage.png"


@dataclass(frozen=True)
class Coverage:
    """Measure and draw how much of the organ an episode shows, over time and by segment.

    There are four levels: `frustum` counts vertices in the field of view, even through walls, as
    VR-Caps does; `visible` the area that is the nearest surface in some pixel; `resolved` the
    visible area that is close and steep enough to show detail; `readable` the resolved area that is
    also well exposed, sharp and not under liquid.

    Writes a table over time (coverage.parquet), the organ with the coverage of each vertex
    (coverage.glb) and a figure (coverage.png).

    For example:
      vrcaps record --out runs/colon --frames 300 --coverage
      vrcaps coverage runs/colon
      vrcaps coverage runs/colon --max-incidence 60 --out figures/colon
    """

    episode: Positional[Path]
    """Folder of the episode, recorded with --coverage."""

    out: Path | None = None
    """Output folder; by default `coverage` in the episode's folder."""

    max_depth: float = CoverageCriteria.max_depth / MM
    """Maximum depth of a vertex at `frustum` [mm]."""

    min_pixels: float = CoverageCriteria.min_pixel_density * MM**2
    """Minimum number of pixels per square millimeter of the wall at `resolved`."""

    max_incidence: float = math.degrees(CoverageCriteria.max_incidence)
    """Maximum angle between the wall's normal and the ray at `resolved` [deg]."""

    def run(self) -> None:
        """Measure, write and report."""
        require_folder(self.episode, "an episode")
        from vrcaps.recording.episode import read_episode
        from vrcaps.tools.reports.coverage import (
            episode_coverage,
            write_coverage_figure,
            write_coverage_mesh,
            write_coverage_table,
        )

        criteria = CoverageCriteria(
            max_depth=self.max_depth * MM,
            min_pixel_density=self.min_pixels / MM**2,
            max_incidence=math.radians(self.max_incidence),
        )
        with progress_bar("measuring coverage") as progress:
            found = episode_coverage(read_episode(self.episode), criteria, progress)
        out = self.out or self.episode / COVERAGE_FOLDER
        out.mkdir(parents=True, exist_ok=True)
        with console.status("drawing"):
            write_coverage_table(out / TABLE, found)
            write_coverage_mesh(out / MESH, found)
            write_coverage_figure(out / FIGURE, found, title=f"{found.organ.name}: coverage")
        _report(found)
        console.print(f"Written: {out / TABLE}, {out / MESH}, {out / FIGURE}")


def _report(found: EpisodeCoverage) -> None:
    from rich.table import Table

    table = Table(title="Coverage [%]")
    table.add_column("segment")
    for level in COVERAGE_LEVELS:
        table.add_column(level, justify="right")
    fractions = {level: found.by_segment(level) for level in COVERAGE_LEVELS}
    for segment in fractions["visible"]:
        row = (f"{100.0 * fractions[level].get(segment, 0.0):.1f}" for level in COVERAGE_LEVELS)
        table.add_row(segment.replace("_", " "), *row)
    whole = (f"{100.0 * found.coverage.fraction(level):.1f}" for level in COVERAGE_LEVELS)
    table.add_row("whole organ", *whole)
    console.print(table)
