"""Scene of episodes, and charts over time: speed, forces, clearance and the error of a path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.scene.colorings import coarse_mesh, coloring_names, make_coloring
from vrcaps.cockpit.scene.external_nodes import MagnetNode, PatientNode
from vrcaps.cockpit.scene.nodes import CUT_AXES, Cut, OrganNode, add_capsule, add_path, aim, move
from vrcaps.core.errors import InputError
from vrcaps.core.transforms import transform_points
from vrcaps.core.units import MM
from vrcaps.magnet.presets import read_magnet
from vrcaps.metrics.trajectory import TrajectoryAlignment, aligned_poses
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.replay import read_tum
from vrcaps.motion.trajectory import resample
from vrcaps.organ.read_organ import read_organ

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float, Int

    from vrcaps.cockpit.scene.colorings import Color
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


EPISODE_COLORS: tuple[Color, ...] = ((255, 190, 40), (80, 200, 255))
ESTIMATE_COLOR: Color = (255, 90, 160)


class EpisodeScene:
    """Scene of one or two episodes; organ, patient and magnet are those of the first."""

    def __init__(self, server: viser.ViserServer, episodes: Sequence[Episode]) -> None:
        self._scene, self._episodes, first = server.scene, episodes, episodes[0]
        self._surface = read_organ(first.organ_path)
        self._T_world_patient = np.array(first.head["T_world_patient"])
        self._vertices = transform_points(self._T_world_patient, self._surface.vertices)
        self._mesh = coarse_mesh(self._vertices, self._surface.faces)
        self._walls = RecordedWalls(first, self._vertices) if "wall" in first.head else None
        self._wall_frame = 0
        self._organ = OrganNode(self._scene, self._mesh)
        self._patient = PatientNode(self._scene, self._surface.vertices)
        self._patients = _poses(first, "patient")
        self._magnet, self._magnets = self._add_magnet(first), _poses(first, "magnet")
        self._capsules = [self._add_episode(k, episode) for k, episode in enumerate(episodes)]
        self._estimate: PathEstimate | None = None
        self._estimate_node: Any = None
        self._drawn: tuple[object, ...] = ()
        above = self._vertices if self._magnets is None else self._magnets[:1, :3, 3]
        high = np.maximum(self._vertices.max(axis=0), above.max(axis=0))
        aim(server, self._vertices.min(axis=0), high)
        self._add_controls(server.gui)

    def show(self, indices: Sequence[int]) -> None:
        """Move all nodes to a frame of each episode."""
        for capsule, episode, index in zip(self._capsules, self._episodes, indices, strict=True):
            move(capsule, episode.Ts_world_capsule[index])
        frame = indices[0]
        if self._estimate is not None:
            pose_index = self._estimate.index_of(frame)
            self._estimate_node.visible = pose_index is not None
            if pose_index is not None:
                move(self._estimate_node, self._estimate.estimated[pose_index])
        lies = self._T_world_patient if self._patients is None else self._patients[frame]
        self._patient.show(lies, is_visible=self._has_patient.value)
        if self._walls is not None and frame != self._wall_frame:
            self._wall_frame = frame
            self._organ.move(self._walls.at(frame))
        if self._magnet is not None and self._magnets is not None:
            self._magnet.show(self._magnets[frame], has_lines=self._has_lines.value)

    def show_estimate(self, estimate: PathEstimate) -> None:
        """Draw an estimated path and its capsule."""
        if self._estimate_node is None:
            device = self._episodes[0].head["capsule"]
            self._estimate_node = add_capsule(
                *(self._scene, "/estimate/capsule", device["length_m"], device["radius_m"]),
                ESTIMATE_COLOR,
            )
        add_path(self._scene, "/estimate/path", estimate.estimated[:, :3, 3], ESTIMATE_COLOR)
        self._estimate = estimate

    def draw_organ(self) -> bool:
        """Draw the organ according to the controls; return whether any control had changed."""
        cut = Cut(self._cut_axis.value, self._cut_fraction.value)
        drawn = (self._color.value, cut, self._opacity.value)
        wanted = (*drawn, self._has_patient.value, self._has_lines.value)
        if wanted == self._drawn:
            return False
        if drawn != self._drawn[:3]:
            coloring = make_coloring(self._color.value, self._surface, self._mesh)
            self._organ.set_opacity(self._opacity.value)
            self._organ.draw(self._vertices, coloring, cut)
            self._wall_frame = -1
            self._legend.content = coloring.legend()
        self._drawn = wanted
        return True

    def _add_controls(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Scene"):
            names = coloring_names(self._surface, is_live=False)
            self._color = gui.add_dropdown("Coloring", names)
            self._opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, 0.35)
            self._cut_axis = gui.add_dropdown("Cutting axis", CUT_AXES)
            self._cut_fraction = gui.add_slider("Cutting position", 0.0, 1.0, 0.05, 0.5)
            self._has_lines = gui.add_checkbox(
                "Field lines", True, visible=self._magnet is not None
            )
            self._has_patient = gui.add_checkbox("Patient and table", True)
            self._legend = gui.add_markdown("")

    def _add_episode(self, episode_index: int, episode: Episode) -> Any:
        """Add capsule and path of an episode."""
        color, device = EPISODE_COLORS[episode_index], episode.head["capsule"]
        positions = episode.Ts_world_capsule[:, :3, 3]
        if len(positions) >= 2:
            add_path(self._scene, f"/path-{episode_index}", positions, color)
        name = f"/capsule-{episode_index}"
        return add_capsule(self._scene, name, device["length_m"], device["radius_m"], color)

    def _add_magnet(self, episode: Episode) -> MagnetNode | None:
        """Add the magnet that steered the capsule, if there was one."""
        motion = episode.scenario.motion
        if not isinstance(motion, Dynamics) or motion.magnet is None:
            return None
        return MagnetNode(self._scene, read_magnet(motion.magnet.magnet))


class RecordedWalls:
    """Walls of an episode recorded with `--wall`, as vertices of its organ."""

    def __init__(self, episode: Episode, vertices: Float[np.ndarray, "n 3"]) -> None:
        """Match each vertex of the file to a vertex of the organ.

        Args:
            episode: Episode with walls.
            vertices: Vertices of the organ at rest in the world [m]. The file repeats some of them
                at texture seams.
        """
        from scipy.spatial import KDTree

        self._episode, self._rest = episode, vertices
        self._nearest = KDTree(vertices).query(episode.organ.vertices)[1]

    def at(self, frame: int) -> Float[np.ndarray, "n 3"]:
        """Vertices of the organ at a frame in the world [m].

        Raises:
            InputError: If the file of that frame is missing or damaged.
        """
        moved = self._rest.copy()
        moved[self._nearest] = self._episode.wall(frame).vertices
        return moved


def _poses(episode: Episode, body: str) -> np.ndarray | None:
    """Poses of a body at each frame; None if they were not recorded."""
    return episode.table.poses(body) if f"{body}_qw" in episode.table.columns else None
