"""Scene of episodes, and charts over time: speed, forces, clearance and the error of a path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cockpit.messages import SetScene
from vrcaps.cockpit.scene.colorings import coarse_mesh, coloring_names, make_coloring
from vrcaps.cockpit.scene.external_nodes import MagnetNode, PatientNode
from vrcaps.cockpit.scene.live_scene import OPACITY
from vrcaps.cockpit.scene.nodes import OrganNode, add_capsule, add_path, cut_of, move
from vrcaps.cockpit.scene.viewpoint import aim
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
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

_CAPSULE_ROOM = 1.5
"""Half the size of the box that frames the capsule, in lengths of the capsule."""


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


@dataclass(frozen=True)
class Column:
    """Quantity of an episode in a chart.

    Attributes:
        name: Name in the page.
        unit: Unit; empty for a ratio.
        min_span: Minimum span of its chart, so that noise does not fill it.
        needs: Table columns that it is computed from.
        of: Computes its values from these columns.
    """

    name: str
    unit: str
    min_span: float
    needs: tuple[str, ...]
    of: Callable[..., np.ndarray]


def _size(*parts: np.ndarray) -> np.ndarray:
    return np.linalg.norm(parts, axis=0)


COLUMNS = (
    Column(
        "Speed",
        "mm/s",
        5.0,
        tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz"),
        lambda *parts: _size(*parts) / MM,
    ),
    Column("Clearance to the wall", "mm", 2.0, ("capsule_clearance_m",), lambda gap: gap / MM),
    Column("Contact force", "mN", 20.0, ("normal_force_total_n",), lambda force: 1e3 * force),
    Column(
        "Magnetic force",
        "mN",
        50.0,
        tuple(f"magnetic_force_{axis}_n" for axis in "xyz"),
        lambda *parts: 1e3 * _size(*parts),
    ),
    Column("Angle to the field", "°", 10.0, ("coupling_angle_rad",), np.rad2deg),
    Column("Insufflation", "×", 0.2, ("insufflation",), lambda factor: factor),
)
"""Quantities of charts; an episode has those whose columns it contains."""

_ESTIMATE_ERROR = {"name": "Error of the estimate", "unit": "mm", "minSpan": 1.0, "digits": 2}


def episode_charts(episodes: Sequence[Episode], *, has_estimate: bool) -> list[dict[str, Any]]:
    """Charts over the time of the first episode, with a line for each episode.

    Args:
        episodes: One or two episodes.
        has_estimate: Whether there is a chart of the error of an estimated path.
    """
    times, charts = episodes[0].times, []
    if has_estimate:
        charts.append({**_ESTIMATE_ERROR, "lines": [], "isEstimate": True})
    for column in COLUMNS:
        lines = [(values_of(column, episode), episode.times) for episode in episodes]
        if all(np.isnan(values).all() for values, _ in lines):
            continue
        resampled = [np.interp(times, at, v, np.nan, np.nan).round(5).tolist() for v, at in lines]
        chart = {"name": column.name, "unit": column.unit, "minSpan": column.min_span}
        charts.append({**chart, "digits": 2, "lines": resampled, "isEstimate": False})
    return charts


def values_of(column: Column, episode: Episode) -> np.ndarray:
    """Values of a column at each frame; NaN where the episode has none."""
    table = episode.table.columns
    if not table.keys() >= set(column.needs):
        return np.full(len(episode.times), np.nan)
    return np.asarray(column.of(*(table[name] for name in column.needs)), float)


EPISODE_COLORS: tuple[Color, ...] = ((255, 190, 40), (86, 180, 233))
ESTIMATE_COLOR: Color = (230, 130, 190)


class EpisodeScene:
    """Scene of one or two episodes; organ, patient and magnet are those of the first.

    Attributes:
        settings: Display settings; may be set at any time.
        legend: Colors and labels of the current coloring.
        colorings: Names of the organ's colorings.
    """

    def __init__(self, server: viser.ViserServer, episodes: Sequence[Episode]) -> None:
        self._scene, self._episodes, first = server.scene, episodes, episodes[0]
        self._surface = read_organ(first.organ_path)
        self._T_world_patient = np.array(first.head["T_world_patient"])
        self._vertices = transform_points(self._T_world_patient, self._surface.vertices)
        self._mesh = coarse_mesh(self._vertices, self._surface.faces)
        self._walls = RecordedWalls(first, self._vertices) if "wall" in first.head else None
        self._points = self._vertices
        self._organ = OrganNode(self._scene, self._mesh)
        self._patient = PatientNode(self._scene, self._surface.vertices)
        self._patients = _poses(first, "patient")
        self._magnet, self._magnets = self._add_magnet(first), _poses(first, "magnet")
        self._capsules = [self._add_episode(k, episode) for k, episode in enumerate(episodes)]
        self._estimate: PathEstimate | None = None
        self._estimate_node: Any = None
        self._drawn: tuple[object, ...] = ()
        self.colorings = coloring_names(self._surface, is_live=False)
        has_magnet = self._magnet is not None
        self.settings = SetScene(self.colorings[0], OPACITY, "capsule", 0.5, has_magnet, True)
        self.legend: list[tuple[list[int], str]] = []
        aim(server, *self.box("all", 0))

    @property
    def has_magnet(self) -> bool:
        """True if a magnet steered the capsule."""
        return self._magnet is not None

    def T_world_patient(self, frame: int) -> Float[np.ndarray, "4 4"]:
        """Posture of the patient at a frame."""
        return self._T_world_patient if self._patients is None else self._patients[frame]

    def box(self, target: str, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box around a target at a frame in the world [m], see `FrameView`."""
        if target == "capsule":
            place = self._episodes[0].Ts_world_capsule[frame][:3, 3]
            half = np.full(3, _CAPSULE_ROOM * self._episodes[0].head["capsule"]["length_m"])
            return place - half, place + half
        low, high = self._vertices.min(axis=0), self._vertices.max(axis=0)
        if target == "all" and self._magnets is not None:
            place = self._magnets[frame][:3, 3]
            low, high = np.minimum(low, place), np.maximum(high, place)
        return low, high

    def show(self, indices: Sequence[int]) -> None:
        """Move all nodes to a frame of each episode."""
        for capsule, episode, index in zip(self._capsules, self._episodes, indices, strict=True):
            move(capsule, episode.Ts_world_capsule[index])
        frame, settings = indices[0], self.settings
        if self._estimate is not None:
            pose_index = self._estimate.index_of(frame)
            self._estimate_node.visible = pose_index is not None
            if pose_index is not None:
                move(self._estimate_node, self._estimate.estimated[pose_index])
        self._patient.show(self.T_world_patient(frame), is_visible=settings.has_patient)
        if self._magnet is not None and self._magnets is not None:
            self._magnet.show(self._magnets[frame], has_lines=settings.has_lines)
        if self._walls is not None:
            self._points = self._walls.at(frame)
        self._draw_organ(frame)

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

    def _draw_organ(self, frame: int) -> None:
        """Draw the organ if its color or cut have changed; otherwise move it."""
        settings, first = self.settings, self._episodes[0]
        pose, radius = first.Ts_world_capsule[frame], first.head["capsule"]["radius_m"]
        cut = cut_of(settings.cut, settings.cut_fraction, pose, radius)
        self._organ.set_opacity(settings.opacity)
        if (settings.coloring, cut) == self._drawn:
            self._organ.move(self._points)
            return
        self._drawn = (settings.coloring, cut)
        coloring = make_coloring(settings.coloring, self._surface, self._mesh)
        self._organ.draw(self._points, coloring, cut)
        self.legend = [(list(color), text) for color, text in coloring.legend()]

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
