"""Visual odometry of a run, from images and their depth alone.

Features are matched between each frame, the frames after it and those most similar; two frames
with enough matches determine the motion between them (`pose_pair`). All frames are chained along
the pairs of most matches, and all pairs are then adjusted jointly (`pose_adjustment`). Depth in
meters gives poses in meters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import Camera, pixel_grid, unproject_pixels
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import invert
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.fusion.fuse import MIN_COSINE
from vrcaps.tools.reconstruction.fusion.pose_adjustment import (
    Deviations,
    PosePair,
    View,
    adjusted_poses,
    pose_pair,
)
from vrcaps.tools.reconstruction.matching import (
    chained,
    connected,
    likely_pairs,
    sift_features,
    without_highlights,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_RIM_PX = 6
"""Width of the excluded rim of a lens's field: its edge does not move, and would match."""


@dataclass(frozen=True)
class OdometrySettings:
    """Settings of the odometry.

    Attributes:
        num_features: Maximum number of SIFT features of an image.
        reach: Number of next frames that each is matched with, besides those most similar.
        tolerance: Maximum distance of an inlier from its predicted position [px].
        angle_deviation: Standard deviation of a feature's image position [px].
        distance_deviation: Standard deviation of the logarithm of estimated distances.
    """

    num_features: Annotated[int, Range(20)] = 1000
    reach: Annotated[int, Range(1)] = 3
    tolerance: Annotated[float, Range(above=0.0)] = 3.0
    angle_deviation: Annotated[float, Range(above=0.0)] = 1.0
    distance_deviation: Annotated[float, Range(above=0.0)] = 0.1

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Odometry:
    """Estimated poses.

    Attributes:
        frames: Indices of the frames with known poses, ascending.
        Ts_first_camera: Their poses in the frame of the first of them [m].
        num_pairs: Number of matched pairs of frames.
    """

    frames: Int[np.ndarray, " n"]
    Ts_first_camera: Float[np.ndarray, "n 4 4"]
    num_pairs: int


def estimated_poses(
    sequence: FrameSequence,
    settings: OdometrySettings,
    *,
    progress: ProgressReport = no_report,
) -> Odometry:
    """Estimate camera poses for the largest connected part of a sequence.

    Args:
        sequence: Images, depth and camera.
        settings: Settings of the odometry.
        progress: Called with the number of frames and pairs done and the total.

    Raises:
        InputError: If the camera or depth is missing, or no two frames overlap.
        MissingExtraError: If OpenCV is not installed.
    """
    count = len(sequence)
    views, pitch = feature_views(sequence, settings, lambda done: progress(done, 2 * count))
    pairs = _pairs(views, settings, settings.tolerance * pitch, progress)
    frames = connected(count, pairs)
    if not frames:
        most = max((len(view.rays) for view in views), default=0)
        raise InputError(
            f"No two of {count} frames of {sequence.name} overlap: too few features "
            f"match (at most {most} per frame). Give frames that overlap more."
        )
    pairs = [pair for pair in pairs if pair.first in frames]
    _, chain = chained(count, frames, pairs, lambda pair: pair.T_second_first)
    poses = np.stack([chain[frame] for frame in frames])
    deviations = Deviations(settings.angle_deviation * pitch, settings.distance_deviation)
    poses = adjusted_poses(poses, *_renumbered(frames, views, pairs), deviations)
    return Odometry(np.array(frames), invert(poses[0]) @ poses, len(pairs))


def feature_views(
    sequence: FrameSequence,
    settings: OdometrySettings,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[list[View], float]:
    """Features of each frame with their positions, and the median angle of a pixel [rad].

    Args:
        sequence: Images, depth and camera.
        settings: Settings of the odometry.
        progress: Called with the number of frames done.

    Raises:
        InputError: If the camera or depth is missing.
        MissingExtraError: If OpenCV is not installed.
    """
    camera = sequence.camera
    if camera is None:
        raise InputError(f"{sequence.name} has no calibrated camera, which odometry requires.")
    is_seen, pitch = _field(camera)
    views = []
    for index in range(len(sequence)):
        rgb = without_highlights(sequence.image("rgb", index))
        depth = sequence.image("depth", index)
        views.append(_view(rgb, depth, camera, is_seen, settings.num_features))
        progress(index + 1)
    return views, pitch


def _field(camera: Camera) -> tuple[Bool[np.ndarray, "h w"], float]:
    """Pixels well within the field, and the median angle of a pixel over them [rad]."""
    from scipy.ndimage import binary_erosion

    rays = unproject_pixels(camera, pixel_grid(camera.width, camera.height))
    is_seen = binary_erosion(rays[..., 2] > MIN_COSINE, iterations=_RIM_PX)
    steps = np.linalg.norm(np.diff(rays, axis=1), axis=2)
    return is_seen, float(np.nanmedian(steps[is_seen[:, 1:]]))


def _view(
    rgb: np.ndarray, depth: np.ndarray, camera: Camera, is_seen: np.ndarray, count: int
) -> View:
    """Features of an image where depth is known, with their positions."""
    features = sift_features(rgb, count, is_seen)
    column, row = np.rint(features.points).astype(int).T
    rays = unproject_pixels(camera, features.points)
    points = rays * (depth[row, column] / rays[:, 2])[:, None]
    known = np.isfinite(points).all(axis=1) & (depth[row, column] > 0.0)
    return View(features.descriptors[known], rays[known], points[known])


def _pairs(
    views: Sequence[View],
    settings: OdometrySettings,
    tolerance: float,
    progress: ProgressReport,
) -> list[PosePair]:
    """Pairs of frames with the motion between them."""
    count = len(views)
    near = {(i, j) for i in range(count) for j in range(i + 1, min(i + 1 + settings.reach, count))}
    chosen = sorted(near | {*likely_pairs([view.descriptors for view in views])})
    pairs = []
    for done, (i, j) in enumerate(chosen, 1):
        pair = pose_pair((i, j), views[i], views[j], tolerance)
        pairs += [] if pair is None else [pair]
        progress(count + done * count // len(chosen), 2 * count)
    return pairs


def _renumbered(
    frames: Sequence[int], views: Sequence[View], pairs: Sequence[PosePair]
) -> tuple[list[View], list[PosePair]]:
    """Select views and pairs of some frames, with indices among these."""
    index = {frame: k for k, frame in enumerate(frames)}
    renumbered = [
        PosePair(index[p.first], index[p.second], p.T_second_first, p.matches) for p in pairs
    ]
    return [views[frame] for frame in frames], renumbered
