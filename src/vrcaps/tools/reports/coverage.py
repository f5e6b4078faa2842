"""Coverage of an episode: measurement from its images, table, mesh and figure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import transform_points, triangle_areas, wall_of
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.core.units import CM
from vrcaps.metrics.coverage import (
    COVERAGE_LEVELS,
    CoverageCriteria,
    CoverageLevel,
    CoverageMap,
    readable_pixels,
    resolved_pixels,
    seen_faces,
    vertices_in_frustum,
)
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface, face_label
from vrcaps.organ.unroll import unroll
from vrcaps.recording.table import FrameTable, write_table
from vrcaps.tools.report import make_figure
from vrcaps.tools.reports.views import VIEWS, outside_view

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from matplotlib.axes import Axes

    from vrcaps.camera.camera import Camera
    from vrcaps.recording.episode import Episode
    from vrcaps.render.channels import Frame

COVERAGE_CHANNELS = ("rgb", "ray_distance", "normal", "face")
"""Channels required to measure coverage."""

_FURTHER_CHANNELS = ("foreground_label", "flow_forward")
"""Optional channels that are used if they were recorded."""


@dataclass(frozen=True)
class EpisodeCoverage:
    """Coverage of the organ in an episode.

    Attributes:
        organ: The organ at rest.
        times: Time of each frame [s].
        coverage: Triangles seen, and the first frame of each.
        criteria: Conditions of each level.
    """

    organ: OrganSurface
    times: Float[np.ndarray, " n"]
    coverage: CoverageMap
    criteria: CoverageCriteria

    def over_time(self, level: CoverageLevel) -> Float[np.ndarray, " n"]:
        """Fraction seen up to each frame."""
        return self.coverage.over_views(level, len(self.times))

    def by_segment(self, level: CoverageLevel) -> dict[str, float]:
        """Fraction seen of each segment."""
        label = self.organ.label
        if level != "frustum":
            label = face_label(label, self.organ.faces)
        return {
            name: self.coverage.fraction(level, label == number)
            for number, name in enumerate(self.organ.label_names)
            if (label == number).any()
        }


def episode_coverage(
    episode: Episode,
    criteria: CoverageCriteria | None = None,
    progress: ProgressReport = no_report,
) -> EpisodeCoverage:
    """Measure the coverage of an episode over its frames, of all its cameras together.

    A moving wall is evaluated at its position in each frame, except for `frustum` in episodes
    without recorded walls, which uses the wall at rest.

    Args:
        episode: Must have the channels of `COVERAGE_CHANNELS`.
        criteria: Conditions under which the wall counts as seen.
        progress: Called with the number of frames done and the total.

    Raises:
        InputError: If a channel was not recorded, or images show another wall.
    """
    missing = [name for name in COVERAGE_CHANNELS if name not in episode.channels]
    if missing:
        raise InputError(
            f"{episode.path} has no {', '.join(missing)}. Record it with --coverage, which adds "
            f"the channels {', '.join(COVERAGE_CHANNELS)}."
        )
    criteria = criteria or CoverageCriteria()
    organ = read_organ(episode.organ_path)
    area = triangle_areas(organ.vertices[organ.faces])
    coverage = CoverageMap(area, len(organ.vertices))
    T_world_patient = np.array(episode.head["T_world_patient"])
    at_rest = transform_points(T_world_patient, organ.vertices)
    further = (name for name in _FURTHER_CHANNELS if name in episode.channels)
    channels = (*COVERAGE_CHANNELS, *further)
    for camera in episode.cameras:
        poses = episode.Ts_world_camera(camera.name)
        for index in range(len(episode)):
            frame = episode.frame(index, camera.name, channels)
            seen = _seen(episode, camera, frame, criteria, len(organ.faces))
            near = vertices_in_frustum(camera, poses[index], at_rest, criteria.max_depth)
            coverage.add({**seen, "frustum": near}, index)
            progress(index + 1, len(episode))
    return EpisodeCoverage(organ, episode.times, coverage, criteria)


def _seen(
    episode: Episode, camera: Camera, frame: Frame, criteria: CoverageCriteria, num_faces: int
) -> dict[CoverageLevel, Bool[np.ndarray, " m"]]:
    """Triangles visible in an image, by level."""
    assert frame.face is not None and frame.ray_distance is not None
    assert frame.normal is not None and frame.rgb is not None
    resolved = resolved_pixels(camera, frame.ray_distance, frame.normal, criteria)
    readable = resolved & readable_pixels(
        frame.rgb,
        criteria,
        foreground_label=frame.foreground_label,
        blur_px=blur_px(episode, camera, frame),
    )
    return {
        "visible": seen_faces(frame.face, num_faces),
        "resolved": seen_faces(frame.face, num_faces, resolved),
        "readable": seen_faces(frame.face, num_faces, readable),
    }


def blur_px(episode: Episode, camera: Camera, frame: Frame) -> Float[np.ndarray, "h w"] | None:
    """Width of the blur by defocus and motion at each pixel [px]; None if neither is simulated.

    The disk of defocus and the image motion during the exposure add in quadrature. Motion counts
    if `flow_forward` was recorded.
    """
    effects = episode.scenario.effects
    focus, motion = effects.resolve("depth_of_field"), effects.resolve("motion_blur")
    squares = []
    if focus is not None and frame.ray_distance is not None:
        squares.append((2.0 * focus.radius_px(camera, frame.ray_distance)) ** 2)
    if motion is not None and frame.flow_forward is not None:
        lit = min(motion.exposure_time, motion.led_pulse or np.inf)
        shutter = min(lit * episode.head["fps"], 1.0)
        squares.append(np.sum((shutter * np.nan_to_num(frame.flow_forward)) ** 2, axis=-1))
    return np.sqrt(sum(squares)) if squares else None


SEEN_COLOR, UNSEEN_COLOR = (64, 176, 80), (200, 48, 48)
"""sRGB colors of seen and unseen wall, as in VR-Caps."""


def write_coverage_table(path: Path, coverage: EpisodeCoverage) -> None:
    """Write the fraction seen up to each frame, one column per level (Parquet).

    Args:
        path: File to write or replace.
        coverage: Coverage of an episode.
    """
    columns: dict[str, np.ndarray] = {
        "frame": np.arange(len(coverage.times)),
        "time_s": np.asarray(coverage.times),
    }
    columns |= {level: coverage.over_time(level) for level in COVERAGE_LEVELS}
    write_table(path, FrameTable(columns))


def write_coverage_mesh(path: Path, coverage: EpisodeCoverage) -> None:
    """Write the organ with vertex colors and the vertex attributes `_COVERAGE` and `_FIRST_SEEN_S`.

    `_COVERAGE` is 0 for an unseen vertex, 1 visible, 2 resolved, 3 readable: the best level of its
    triangles. `_FIRST_SEEN_S` is the time at which it was first visible [s]; −1: never.

    Args:
        path: GLB file to write or replace.
        coverage: Coverage of an episode.
    """
    trimesh = import_extra("trimesh", "reports")

    organ, first = coverage.organ, coverage.coverage.first_seen["visible"]
    level = vertex_level(coverage)
    seen = first >= 0
    time = np.full(len(organ.vertices), np.inf)
    times = np.repeat(np.asarray(coverage.times)[first[seen]], 3)
    np.minimum.at(time, organ.faces[seen].ravel(), times)
    colors = np.where(level[:, None] > 0, SEEN_COLOR, UNSEEN_COLOR).astype(np.uint8)
    mesh = trimesh.Trimesh(organ.vertices, organ.faces, vertex_colors=colors, process=False)
    mesh.vertex_attributes["_COVERAGE"] = level.astype(np.float32)
    mesh.vertex_attributes["_FIRST_SEEN_S"] = np.where(np.isfinite(time), time, -1.0).astype(
        np.float32
    )
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    write_bytes(path, data)


def vertex_level(coverage: EpisodeCoverage) -> Int[np.ndarray, " n"]:
    """Best level of each vertex's triangles: 0 unseen, 1 visible, 2 resolved, 3 readable."""
    level = np.zeros(len(coverage.organ.vertices), np.int32)
    for number, name in enumerate(COVERAGE_LEVELS[1:], start=1):
        level[coverage.organ.faces[coverage.coverage.seen(name)].ravel()] = number
    return level


LEVEL_COLORS = np.array(
    [[0.80, 0.20, 0.20], [0.95, 0.70, 0.30], [0.55, 0.80, 0.45], [0.1, 0.6, 0.3]]
)
"""sRGB colors of the unseen wall and of the levels `visible`, `resolved` and `readable`."""

_CURVES = {"frustum": "#999999", "visible": "#e0982f", "resolved": "#7cb860", "readable": "#1a8a4a"}
_NAMES = ("not seen", *COVERAGE_LEVELS[1:])
_SIZE_INCH, _DPI = (13.0, 11.0), 110
_UNROLLED_PX = (180, 1200)


def write_coverage_figure(path: Path, coverage: EpisodeCoverage, *, title: str = "") -> None:
    """Draw the organ from two sides, its unrolled wall, coverage over time and by segment.

    Args:
        path: Image to write; its suffix determines the format.
        coverage: Coverage of an episode.
        title: Title above the figure.
    """
    fig = make_figure(*_SIZE_INCH)
    fig.suptitle(title)
    grid = fig.add_gridspec(3, 2, height_ratios=[1.5, 0.5, 0.8])
    organ = replace(coverage.organ, label=vertex_level(coverage).astype(np.uint8))
    wall = wall_of(organ.vertices, organ.faces)
    low, high = organ.vertices.min(axis=0), organ.vertices.max(axis=0)
    center, half = 0.5 * (low + high), 0.52 * float((high - low).max())
    for column, (name, axes) in enumerate(VIEWS.items()):
        view = fig.add_subplot(grid[0, column])
        view.imshow(outside_view(organ, wall, axes, center, half, colors=LEVEL_COLORS))
        view.set_axis_off()
        view.set_title(name, fontsize=10)
    _draw_unrolled(fig.add_subplot(grid[1, :]), organ, wall)
    _draw_over_time(fig.add_subplot(grid[2, 0]), coverage)
    _draw_segments(fig.add_subplot(grid[2, 1]), coverage)
    fig.legend(handles=_legend(), loc="outside lower center", ncols=4, frameon=False)
    fig.savefig(path, dpi=_DPI)


def _legend() -> list[Any]:
    Patch = import_extra("matplotlib.patches", "reports", package="matplotlib").Patch

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


def _draw_over_time(view: Axes, coverage: EpisodeCoverage) -> None:
    for level in COVERAGE_LEVELS:
        curve = 100.0 * coverage.over_time(level)
        view.plot(coverage.times, curve, color=_CURVES[level], label=f"{level}, {curve[-1]:.1f} %")
    view.set(xlabel="time [s]", ylabel="coverage [%]", ylim=(0, 100))
    view.grid(alpha=0.3)
    view.legend(frameon=False)


def _draw_segments(view: Axes, coverage: EpisodeCoverage) -> None:
    """Draw bars of each segment's coverage at the nested levels."""
    fractions = {level: coverage.by_segment(level) for level in COVERAGE_LEVELS[1:]}
    names = list(fractions["visible"])
    for number, by_name in enumerate(fractions.values(), start=1):
        values = [100.0 * by_name[name] for name in names]
        view.barh(names, values, color=LEVEL_COLORS[number])
    view.set(xlim=(0, 100), xlabel="coverage of the segment [%]")
    view.set_facecolor((*LEVEL_COLORS[0], 0.25))
    view.invert_yaxis()
