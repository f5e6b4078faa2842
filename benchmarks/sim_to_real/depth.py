"""Depth on real frames by networks trained on none: a dense phantom, points of a patient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sim_to_real.simulated import evenly
from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.color import linear_from_srgb
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, matrix_from_quaternion, transform_from, transform_points
from vrcaps.formats.io import read_format
from vrcaps.formats.shared.stored_images import image_size, read_plane, read_rgb
from vrcaps.formats.shared.text_files import read_yaml
from vrcaps.learn.networks import Backbone
from vrcaps.learn.picture_border import Letterbox, tissue_view
from vrcaps.learn.samples import batch_of
from vrcaps.learn.tasks.depth import DepthTask, depth_of
from vrcaps.metrics.depth import depth_errors
from vrcaps.recording.frame_sequence import FrameSequence

_STEP = 4
"""Every so many pixels of a dense map count, along rows and columns."""
_BETWEEN = -1
"""Separator between the lists of views of two points."""

Estimate = Callable[[np.ndarray, Camera], np.ndarray]
"""Depth [h w], up to scale, of an image [h w 3] that a camera took."""


@dataclass(frozen=True)
class DepthImage:
    """A real image with depth at some of its pixels.

    Attributes:
        image: Colors, uint8 [h w 3].
        camera: Its lens.
        pixels: Column and row of pixels with known depth, int [n 2].
        depth: Their depth [n], up to a scale.
        group: Number of its sequence.
    """

    image: np.ndarray
    camera: Camera
    pixels: np.ndarray
    depth: np.ndarray
    group: int


def read_c3vd(folder: Path) -> list[DepthImage]:
    """Frames of C3VD, in the layout of the data set or of its first release.

    Raises:
        InputError: If it is neither, or has no calibration.
    """
    try:
        sequences = read_format("c3vd", folder)
    except InputError:
        sequences = read_format("c3vd", folder, layout="flat")
    found = []
    for group, sequence in enumerate(sequences):
        if sequence.camera is None:
            raise InputError(f"{sequence.name} in {folder} has no calibration of its lens.")
        for index in range(len(sequence)):
            depth = sequence.image("depth", index)[::_STEP, ::_STEP]
            row, column = np.nonzero(np.isfinite(depth) & (depth > 0.0))
            pixels = _STEP * np.column_stack([column, row])
            image = sequence.image("rgb", index)
            whole = DepthImage(image, sequence.camera, pixels, depth[row, column], group)
            found.append(without_border(whole))
    return found


def read_sinus(folder: Path) -> list[DepthImage]:
    """Frames of one sequence with points of structure from motion (Liu et al., IEEE TMI 39, 2020).

    The calibration is for images of 1920 × 1080 pixels, or of 960 × 540 and halved then.

    Raises:
        InputError: If a file is missing or damaged.
    """
    try:
        points = _read_points(folder / "structure.ply")
        views = [int(line) for line in (folder / "visible_view_indexes").read_text().split()]
        seen = _read_seen(folder / "view_indexes_per_point", len(points))
        numbers = np.array((folder / "camera_intrinsics_per_view").read_text().split(), float)
        poses = _read_motion(folder / "motion.yaml", len(views))
    except (OSError, ValueError, LookupError) as error:
        raise InputError(f"{folder} is not in the layout of the sinus data: {error}.") from error
    mask_path = folder / "mask.png"
    found = []
    for number, (view, T_world_camera) in enumerate(zip(views, poses, strict=True)):
        path = folder / f"{view:08d}.jpg"
        height, width = image_size(path)
        fx, fy, cx, cy = numbers[4 * number : 4 * number + 4] if len(numbers) > 4 else numbers
        half = 0.5 if cx > 0.75 * width else 1.0
        fx, fy, cx, cy = (half * float(value) for value in (fx, fy, cx, cy))
        camera = Camera("sinus", LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy), width, height)
        own = points[[view in of for of in seen]]
        pixels, depth = _projected(own, T_world_camera, camera)
        if mask_path.is_file():
            inside = _mask(mask_path, width, height)[pixels[:, 1], pixels[:, 0]]
            pixels, depth = pixels[inside], depth[inside]
        if len(depth) > 2:
            found.append(without_border(DepthImage(read_rgb(path), camera, pixels, depth, 0)))
    return found


def without_border(one: DepthImage) -> DepthImage:
    """Image without black border and inserts, as in `vrcaps predict` and `vrcaps evaluate`."""
    view = tissue_view(one.image, one.camera)
    rows, columns = view.region
    pixels = one.pixels - (columns.start, rows.start)
    height, width = view.image.shape[:2]
    inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
    pixels, depth = pixels[inside], one.depth[inside]
    is_tissue = ~view.is_insert[pixels[:, 1], pixels[:, 0]]
    camera: Any = view.camera
    return DepthImage(view.image, camera, pixels[is_tissue], depth[is_tissue], one.group)


def _projected(
    points: np.ndarray, T_world_camera: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [n 2] and depth [n] of the points that fall into the image."""
    local = transform_points(invert(T_world_camera), points)
    local = local[local[:, 2] > 0.0]
    pixels = np.rint(camera.lens.project(local)).astype(int)
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    return pixels[inside], local[inside, 2]


def _read_points(path: Path) -> np.ndarray:
    """Vertices [n 3] of an ASCII PLY file; elements that PCL writes after them are left out."""
    head, _, body = path.read_text().partition("end_header\n")
    words = head.split()
    count = int(words[words.index("vertex") + 1])
    return np.array([line.split()[:3] for line in body.splitlines()[:count]], float)


def _read_seen(path: Path, count: int) -> list[set[int]]:
    """Views that see each point."""
    found: list[set[int]] = []
    for word in path.read_text().split():
        if int(word) == _BETWEEN:
            found.append(set())
        else:
            found[-1].add(int(word))
    if len(found) != count:
        raise ValueError(f"{path.name} is of {len(found)} points, there are {count}")
    return found


def _read_motion(path: Path, count: int) -> np.ndarray:
    """Poses of the camera in the world [n 4 4]."""
    poses = read_yaml(path)["poses[]"]
    found = []
    for number in range(count):
        pose = poses[f"poses[{number}]"]
        place = [float(pose["position"][axis]) for axis in "xyz"]
        turn = [float(pose["orientation"][axis]) for axis in "wxyz"]
        found.append(transform_from(matrix_from_quaternion(np.array(turn)), np.array(place)))
    return np.stack(found)


def _mask(path: Path, width: int, height: int) -> np.ndarray:
    stored = read_plane(path) > 0
    rows = np.arange(height) * stored.shape[0] // height
    columns = np.arange(width) * stored.shape[1] // width
    return stored[np.ix_(rows, columns)]


def depth_values(estimate: Estimate, images: Sequence[DepthImage]) -> dict[str, list[float]]:
    """Relative error after scaling by medians, and rank correlation, of each image."""
    from scipy.stats import spearmanr

    found: dict[str, list[float]] = {"abs_rel": [], "rank": []}
    for one in images:
        column, row = one.pixels.T
        depth = estimate(one.image, one.camera)[row, column]
        errors = depth_errors(depth, one.depth, align="median")
        rank: Any = spearmanr(depth, one.depth).statistic if np.ptp(depth) > 0.0 else 0.0
        found["abs_rel"].append(round(errors.abs_rel, 5))
        found["rank"].append(round(float(rank), 5))
    return found


def by_network(trained: Any) -> Estimate:
    """Estimates of a trained network."""
    learner: DepthTask = trained.task

    def estimate(image: np.ndarray, camera: Camera) -> np.ndarray:
        view = tissue_view(image, camera)
        fit = Letterbox(view.image.shape[0], view.image.shape[1], learner.input_size)
        output = trained(batch_of([learner.view_inputs(view)], trained.device))[0]
        return view.whole(fit.back(depth_of(output)))

    return estimate


def by_mean(sequences: Sequence[FrameSequence], size: int, most: int = 300) -> Estimate:
    """Mean depth of the training images at each pixel: a baseline that ignores the image."""
    learner = DepthTask(backbone=Backbone(size))
    logs = [np.log(learner.sample(*frame)["depth"]) for frame in evenly(sequences, most)]
    with np.errstate(invalid="ignore"):
        known = np.isfinite(logs)
    total = np.where(known, logs, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    mean = np.exp(np.where(known.any(axis=0), total, np.median(total)))

    def estimate(image: np.ndarray, camera: Camera) -> np.ndarray:
        return Letterbox(image.shape[0], image.shape[1], size).back(mean)

    return estimate


def constant(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Constant depth."""
    return np.ones(image.shape[:2])


def by_light(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Inverse square root of linear brightness: the distance of a flat wall of one color.

    Smoothed over a fiftieth of the width, so that highlights and noise count less.
    """
    from scipy.ndimage import gaussian_filter

    linear = linear_from_srgb(image).mean(axis=-1)
    return 1.0 / np.sqrt(gaussian_filter(linear, image.shape[1] / 50.0) + 0.004)
