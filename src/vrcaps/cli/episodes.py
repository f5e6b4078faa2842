"""Verbs on recorded episodes: `vrcaps check`, `coverage`, `view` and `scene`."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from vrcaps.cli.arguments import require_folder
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import require_extra
from vrcaps.core.units import MM
from vrcaps.metrics.coverage import COVERAGE_LEVELS, CoverageCriteria

if TYPE_CHECKING:
    from vrcaps.tools.reports.coverage import EpisodeCoverage

EXIT_FAULTS = 1


@dataclass(frozen=True)
class Check:
    """Verify an episode: all files exist, are intact, and match the poses, cameras and organ.

    Prints one line per fault and exits with status 1 if there are any.

    For example:
      vrcaps check runs/demo
    """

    episode: Positional[Path]
    """Folder of the episode."""

    def run(self) -> None:
        """Check and report."""
        require_folder(self.episode, "an episode")
        from vrcaps.recording.check import check_episode

        with progress_bar("checking") as progress:
            problems = check_episode(self.episode, progress=progress)
        for problem in problems:
            console.print(str(problem))
        if problems:
            noun = "fault" if len(problems) == 1 else "faults"
            console.print(f"{len(problems)} {noun} in {self.episode}.")
            raise SystemExit(EXIT_FAULTS)
        console.print(f"{self.episode} is complete and consistent.")


COVERAGE_FOLDER = "coverage"
TABLE, MESH, PLOT = "coverage.parquet", "coverage.glb", "coverage.png"


@dataclass(frozen=True)
class Coverage:
    """Measure and draw how much of the organ an episode shows, over time and by segment.

    There are four levels: `frustum` counts vertices in the field of view, even through walls, as
    VR-Caps does; `visible` the area that is the nearest surface in some pixel; `resolved` the
    visible area that is close and steep enough to show detail; `readable` the resolved area that is
    also well exposed, sharp and not under liquid.

    Writes a table over time (coverage.parquet), the organ with the coverage of each vertex
    (coverage.glb) and a plot (coverage.png).

    For example:
      vrcaps record --out runs/colon --frames 300 --coverage
      vrcaps coverage runs/colon
      vrcaps coverage runs/colon --max-incidence 60 --out plots/colon
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
        require_extra("reports", "matplotlib", "trimesh")
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
            result = episode_coverage(read_episode(self.episode), criteria, progress)
        out = self.out or self.episode / COVERAGE_FOLDER
        out.mkdir(parents=True, exist_ok=True)
        with console.status("drawing"):
            write_coverage_table(out / TABLE, result)
            write_coverage_mesh(out / MESH, result)
            write_coverage_figure(out / PLOT, result, title=f"{result.organ.name}: coverage")
        _report(result)
        console.print(f"Wrote {out / TABLE}, {out / MESH} and {out / PLOT}.")


def _report(result: EpisodeCoverage) -> None:
    from rich.table import Table

    table = Table(title="Coverage [%]")
    table.add_column("segment")
    for level in COVERAGE_LEVELS:
        table.add_column(level, justify="right")
    fractions = {level: result.by_segment(level) for level in COVERAGE_LEVELS}
    for segment in fractions["visible"]:
        row = (f"{100.0 * fractions[level].get(segment, 0.0):.1f}" for level in COVERAGE_LEVELS)
        table.add_row(segment.replace("_", " "), *row)
    whole = (f"{100.0 * result.coverage.fraction(level):.1f}" for level in COVERAGE_LEVELS)
    table.add_row("whole organ", *whole)
    console.print(table)


@dataclass(frozen=True)
class View:
    """Browse an episode in a browser: all images, and the capsule's path in the organ.

    Two episodes are shown side by side at the same time. An estimated path is drawn with the true
    one, and its error is plotted. The page opens only with the printed address, which contains a
    token.

    For example:
      vrcaps view runs/demo
      vrcaps view runs/drive/episode-1 runs/again
      vrcaps view runs/demo --estimate slam.txt
    """

    episodes: Positional[tuple[Path, ...]]
    """Folders of one or two episodes."""

    estimate: Path | None = None
    """TUM file of an estimated path of the first episode's capsule [m], at its frames' times."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 also admits other machines."""

    port: int = 8080
    """Port to listen on."""

    def run(self) -> None:
        """Serve the page until Ctrl-C.

        Raises:
            InputError: If an episode cannot be read, the times of the estimate do not match, or the
                port is in use.
        """
        for episode in self.episodes:
            require_folder(episode, "an episode")
        from vrcaps.cockpit.episode_page import open_episodes

        with open_episodes(
            self.episodes,
            estimate=self.estimate,
            host=self.host,
            port=self.port,
            on_message=console.print,
        ) as (_, gate):
            console.print(f"Open {gate.address} in a browser; Ctrl-C stops the server.")
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                console.print("Stopping …")


@dataclass(frozen=True)
class Scene:
    """Write the scene of an episode at a frame for other simulators: MJCF for MuJoCo, or USD.

    The scene contains the wall, the capsule with its mass and, if the capsule was steered, the
    magnet and the arm. Coils are not exported. The wall is deformed as in the frame if it was
    recorded with --wall, otherwise at rest.

    For example:
      vrcaps scene runs/steer --out steer.xml
      vrcaps scene runs/steer --frame 20 --out steer.usda
    """

    episode: Positional[Path]
    """Folder of the episode."""

    out: Path
    """File to write: .xml (MJCF, with OBJ files next to it), .usda, .usd or .usdc."""

    frame: int = 0
    """Index of the frame."""

    def run(self) -> None:
        """Write the file."""
        require_folder(self.episode, "an episode")
        from vrcaps.recording.episode import read_episode
        from vrcaps.tools.scene import scene_of, write_scene

        episode = read_episode(self.episode)
        scene = scene_of(episode, self.frame)
        written = write_scene(scene, self.out)
        parts = ["wall", "capsule", *(["magnet"] if scene.magnet is not None else [])]
        parts += ["arm"] * (scene.arm is not None)
        has_coils = getattr(episode.scenario.motion, "coils", None) is not None
        omitted = ", without the coils" if has_coils else ""
        console.print(f"Wrote {', '.join(parts)} to {written}{omitted}.")
