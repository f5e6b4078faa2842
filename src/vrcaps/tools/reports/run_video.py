"""Video of the median run: camera image, organ seen and unseen, and coverage curve."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import invert, matrix_from_quaternion, transform_from, wall_of
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.env.cameras import resized_camera
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points, wall_points
from vrcaps.policy.evaluate import organ_name
from vrcaps.policy.evaluation import POSE
from vrcaps.recording.pictures import Preview
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.tools.reports.coverage import LEVEL_COLORS
from vrcaps.tools.reports.evaluation import MEDIAN_OF, Subject
from vrcaps.tools.reports.views import VIEWS, exposed_image, outside_view, project, view_rays
from vrcaps.world.model import Model, State

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.env.patients import Patient
    from vrcaps.env.settings import EnvSettings

_FASTER, _EVERY = 2.0, 2
"""Playback speed, and number of actions per video frame."""

_SIZE_PX, _STRIP_PX = 360, 70
_BACKGROUND, _TEXT = (18, 18, 22), (230, 230, 230)
_SEEN, _CAPSULE = (85, 180, 105), (30, 90, 235)


def write_run_video(path: Path, subject: Subject, progress: ProgressReport = no_report) -> None:
    """Write a video of the median run of a subject, with the wall at rest.

    Args:
        path: MP4 to write or replace.
        subject: Evaluated policy.
        progress: Called with the number of frames done and the total.
    """
    row = subject.evaluation.median_row(MEDIAN_OF)
    curves = subject.evaluation.episode_curves(row)
    patient = _patient(subject.settings, str(row["organ"]))
    poses = _poses(curves)
    first_seen = faces_first_seen(subject.settings, patient.model, poses)
    views = [_View(patient.model, axes) for axes in VIEWS.values()]
    camera = resized_camera(patient.model.device.cameras[0], _SIZE_PX, _SIZE_PX)
    renderer = Renderer(
        patient.model, RenderSettings(light="direct", supersampling=2, shadows=True)
    )
    fps = _FASTER / (_EVERY * subject.settings.control_period)
    width = _SIZE_PX * (1 + len(views))
    video = Preview(fps=fps, width=width, height=_SIZE_PX + _STRIP_PX)
    for number in range(0, len(poses), _EVERY):
        pose = poses[number]
        inside = exposed_image(renderer, State(0.0, pose), camera)
        pictures = [inside, *(view.at(first_seen <= number, pose) for view in views)]
        strip = _strip(curves, number, width)
        video.add([np.vstack([np.hstack(pictures), strip])])
        progress(number + 1, len(poses))
    write_bytes(path, video.finish())


def faces_first_seen(
    settings: EnvSettings, model: Model, poses: Float[np.ndarray, "t 4 4"]
) -> Int[np.ndarray, " m"]:
    """Index of the pose that first sees each triangle's center; `len(poses)` if none does."""
    points = wall_points(model.organ, None)
    num_faces, bit = len(model.organ.faces), 1 << POINT_LEVELS.index("visible")
    flags, cells = np.zeros(len(points), np.uint8), np.zeros((1, int(points.cell.max()) + 1))
    last = points.first_of_lesions
    first = np.full(num_faces, len(poses))
    for number, pose in enumerate(poses):
        for camera in model.device.cameras:
            mark_points(
                [model.wall],
                [points],
                camera,
                (pose @ camera.T_capsule_camera)[None],
                [flags],
                cells,
                settings.criteria,
            )
        seen = (flags[last - num_faces : last] & bit) > 0
        first[seen & (first == len(poses))] = number
    return first


class _View:
    """View of the organ from outside; only its colors change."""

    def __init__(self, model: Model, axes: Float[np.ndarray, "3 3"]) -> None:
        organ = model.organ
        wall = wall_of(organ.vertices, organ.faces)
        low, high = organ.vertices.min(axis=0), organ.vertices.max(axis=0)
        self._center, self._half = 0.5 * (low + high), 0.55 * float((high - low).max())
        self._axes, self._T_patient_world = axes, invert(model.T_world_patient)
        white = np.ones((len(organ.label_names), 3))
        args = (axes, self._center, self._half)
        self._shade = outside_view(organ, wall, *args, colors=white, size_px=_SIZE_PX)
        _, face = wall.cast(*view_rays(*args, _SIZE_PX))
        self._face = face.reshape(_SIZE_PX, _SIZE_PX)

    def at(self, seen: np.ndarray, pose: Float[np.ndarray, "4 4"]) -> np.ndarray:
        """Draw the organ with its seen part, and the capsule as a line through the wall."""
        colors = np.stack([255.0 * LEVEL_COLORS[0], np.array(_SEEN, float)])
        image = colors[seen[self._face].astype(int)] * self._shade
        image[self._face < 0] = _BACKGROUND
        T = self._T_patient_world @ pose
        for along in np.linspace(-0.012, 0.012, 25):
            x, y = project(T[:3, 3] + along * T[:3, 2], self._axes, self._center) / self._half
            column, row = int((x + 1.0) * _SIZE_PX / 2.0), int((1.0 - y) * _SIZE_PX / 2.0)
            size = 3 if along > 0.008 else 2
            image[max(row - size, 0) : row + size, max(column - size, 0) : column + size] = _CAPSULE
        return image.clip(0, 255).astype(np.uint8)


def _strip(curves: dict[str, np.ndarray], index: int, width: int) -> np.ndarray:
    """Draw time, coverage, and the coverage curve up to now."""
    from PIL import Image, ImageDraw

    strip = Image.new("RGB", (width, _STRIP_PX), _BACKGROUND)
    draw = ImageDraw.Draw(strip)
    time, percent = curves["time_s"], 100.0 * curves["visible"]
    caption = f"{time[index]:5.1f} s   visible {percent[index]:5.1f} %"
    draw.text((10, _STRIP_PX // 2 - 8), caption, fill=_TEXT, font_size=15)
    left, right, top, low = _SIZE_PX - 130, width - 12, 8, _STRIP_PX - 10
    draw.line([(left, low), (right, low)], fill=(90, 90, 90))
    draw.line([(left, top), (right, top)], fill=(60, 60, 60))
    x = left + (right - left) * time / max(float(time[-1]), 1e-9)
    y = low - (low - top) * percent / 100.0
    if index:
        draw.line(list(zip(x[: index + 1], y[: index + 1], strict=True)), fill=_SEEN, width=2)
    return np.asarray(strip)


def _poses(curves: dict[str, np.ndarray]) -> Float[np.ndarray, "t 4 4"]:
    """Poses of the capsule over time."""
    pose = np.stack([curves[name] for name in POSE], axis=-1)
    return transform_from(matrix_from_quaternion(pose[:, 3:]), pose[:, :3])


def _patient(settings: EnvSettings, name: str) -> Patient:
    """Return the patient with a name, with its textures."""
    organ = next(o for o in settings.organs if organ_name(o) == name)
    settings = replace(settings, organs=(organ,))
    return settings.patients(with_textures=True)[0]
