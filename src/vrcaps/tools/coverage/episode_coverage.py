"""Coverage of an episode, measured from its images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.transforms import transform_points
from vrcaps.metrics.coverage import (
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

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

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
    progress: Callable[[int, int], None] | None = None,
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
            f"{episode.path} holds no {', '.join(missing)}. Record it with --coverage, which adds "
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
            if progress is not None:
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
