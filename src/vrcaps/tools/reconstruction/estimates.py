"""Sequences with estimated depth and poses, and reconstructed walls compared with the true one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.camera import Camera, pixel_grid
from vrcaps.core.color import turbo
from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.files import atomic_write, write_bytes, write_csv
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.units import MM
from vrcaps.formats.detection.image_folders import file_name
from vrcaps.formats.slam.tum import poses_of
from vrcaps.mesh.mesh import Mesh
from vrcaps.metrics.depth import SurfaceErrors, surface_distances, surface_errors
from vrcaps.metrics.trajectory import TrajectoryAlignment, aligned_poses, fit_similarity
from vrcaps.motion.replay import tum_rows
from vrcaps.recording.frame_files import read_image
from vrcaps.recording.frame_sequence import CAMERA_POSE, FrameSequence
from vrcaps.render.channels import CHANNELS
from vrcaps.tools.report import make_figure

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.learn.checkpoint import TrainedNetwork

_SLACK = 0.5
"""Maximum difference between the times of a pose and a frame, in frames."""
_REACH = 20.0 * MM
"""Distance of the points that represent the view of a camera."""


def with_depth(
    sequence: FrameSequence, depth_of: Callable[[int], Float[np.ndarray, "h w"]]
) -> FrameSequence:
    """Copy of a sequence with other depth.

    Args:
        sequence: Images.
        depth_of: Depth z of a frame [m].
    """

    def load(channel: str, index: int) -> np.ndarray:
        return depth_of(index) if channel == "depth" else sequence.load(channel, index)

    names = {*sequence.channels, "depth"}
    channels = tuple(name for name in CHANNELS if name in names)
    return replace(sequence, channels=channels, load=load)


def with_poses(
    sequence: FrameSequence, Ts_world_camera: Float[np.ndarray, "n 4 4"]
) -> FrameSequence:
    """Copy of a sequence with other camera poses.

    Raises:
        InputError: If the number of poses differs from the number of frames.
    """
    if len(Ts_world_camera) != len(sequence):
        raise InputError(f"There are {len(Ts_world_camera)} poses for {len(sequence)} frames.")
    return replace(sequence, values={**sequence.values, CAMERA_POSE: Ts_world_camera})


def aligned(
    sequence: FrameSequence, truth: Float[np.ndarray, "n 4 4"], align: TrajectoryAlignment
) -> FrameSequence:
    """Align a sequence to its true poses; depth is scaled like the poses.

    A capsule travels almost straight, so positions alone hardly determine the rotation about its
    path. The motion is therefore fitted to positions and to points in front of each camera.

    Args:
        sequence: With estimated poses, and depth of the same scale.
        truth: True ``T_world_camera`` of its frames.
        align: Type of motion; `sim3` also scales depth.

    Raises:
        InputError: If a scale is fitted to collinear positions.
    """
    if align == "none":
        return sequence
    poses, scale = sequence.Ts_world_camera.copy(), 1.0
    if align == "sim3":
        scale = fit_similarity(poses[:, :3, 3], truth[:, :3, 3], scale=True).scale
        poses[:, :3, 3] *= scale
    motion = fit_similarity(_before(poses), _before(truth), scale=False)
    moved = with_poses(sequence, motion.poses(poses))
    return with_depth(moved, lambda index: scale * sequence.image("depth", index))


def _before(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "m 3"]:
    """Positions of cameras, and points along their axes [m]."""
    positions = poses[:, None, :3, 3]
    along = positions + _REACH * np.swapaxes(poses[:, :3, :3], 1, 2)
    return np.concatenate([positions, along], axis=1).reshape(-1, 3)


def read_depth(folder: Path, sequence: FrameSequence) -> FrameSequence:
    """Copy of a sequence with the depth [m] that was estimated from its frames.

    Args:
        folder: Output of `vrcaps predict depth`.
        sequence: Sequence of these images.

    Raises:
        InputError: If the folder contains none of this sequence; on reading an image, if a file is
            damaged.
    """
    subfolder = folder / sequence.name
    if not subfolder.is_dir():
        raise InputError(f"{folder} contains no depth of {sequence.name}: {subfolder} is missing.")

    def depth_of(index: int) -> np.ndarray:
        path = subfolder / f"{file_name(sequence, index)}.png"
        try:
            return CHANNELS["depth"].encoding.decode(read_image(path))
        except (OSError, ValueError) as error:
            raise InputError(f"Cannot read {path}: {error}.") from error

    return with_depth(sequence, depth_of)


def with_network_depth(sequence: FrameSequence, trained: TrainedNetwork) -> FrameSequence:
    """Copy of a sequence with depth estimated by a network on access, as by `vrcaps predict`.

    It is NaN in the black border and the inserts of an endoscope's picture.

    Args:
        sequence: Images and camera.
        trained: Weights of the task `depth` or, up to scale, `sfm`.

    Raises:
        InputError: If the weights are of another task, or there is no camera.
    """
    camera = sequence.camera
    if camera is None:
        raise InputError(f"{sequence.name} has no calibrated camera, which depth requires.")
    from vrcaps.learn.picture_border import view_of

    require_depth(trained)
    lengths = {"predicts_lengths": trained.task.predicts_lengths}

    def depth_of(index: int) -> Float[np.ndarray, "h w"]:
        view = view_of(sequence, index, **lengths)
        given = view.image, view.camera or camera, view.log_scale, view.exposure
        depth = view.whole(network_depth(trained, *given))
        return np.where(depth > 0.0, depth, np.nan)

    return with_depth(sequence, depth_of)


def network_depth(
    trained: TrainedNetwork,
    rgb: UInt8[np.ndarray, "h w 3"],
    camera: Camera,
    log_scale: float = 0.0,
    exposure: float = 1.0,
) -> Float[np.ndarray, "h w"]:
    """Estimate depth z of an image [m] by a network; up to scale for the task `sfm`.

    Args:
        trained: Weights of the task `depth` or `sfm`.
        rgb: The image.
        camera: Camera of the image.
        log_scale: Logarithm of the factor of distances at an unknown exposure.
        exposure: Exposure relative to the camera's own.

    Raises:
        InputError: If the weights are of another task.
    """
    from vrcaps.learn.picture_border import Letterbox
    from vrcaps.learn.samples import batch_of
    from vrcaps.learn.task import scalars

    require_depth(trained)
    height, width = rgb.shape[:2]
    letterbox = Letterbox(height, width, trained.task.input_size)
    stated = scalars(log_scale=log_scale, exposure=exposure)
    sample = trained.task.inputs(rgb, letterbox, camera) | stated
    image = trained.task.files(trained(batch_of([sample]))[0], letterbox)[".png"]
    depth = CHANNELS["depth"].encoding.decode(image)
    if trained.task.kind == "sfm":  # distances along rays
        depth = depth * camera.lens.unproject(pixel_grid(width, height))[..., 2]
    return depth


def require_depth(trained: TrainedNetwork) -> None:
    """Check that weights belong to a task that estimates depth.

    Raises:
        InputError: If they do not.
    """
    kind = trained.task.kind
    if kind not in ("depth", "sfm"):
        raise InputError(f"The weights are of the task {kind!r}. Allowed: 'depth' or 'sfm'.")


def read_poses(
    path: Path, sequence: FrameSequence, align: TrajectoryAlignment
) -> Float[np.ndarray, "n 4 4"]:
    """Read the estimated ``T_world_camera`` of each frame, aligned to the true ones.

    Args:
        path: Rows ``timestamp tx ty tz qx qy qz qw``.
        sequence: Sequence of the frames; each takes the pose of its time.
        align: Type of motion to fit for the alignment.

    Raises:
        InputError: If a frame has no pose of its time, or the file cannot be read.
    """
    _, rows = tum_rows(path)
    apart = np.abs(rows[:, 0][None] - sequence.times[:, None])
    nearest = apart.argmin(axis=1)
    step = np.median(np.diff(sequence.times)) if len(sequence) > 1 else np.inf
    far = apart[np.arange(len(sequence)), nearest] > _SLACK * step
    if far.any():
        time = sequence.times[far][0]
        raise InputError(f"{path} has no pose of the frame at {time:.3f} s; {far.sum()} lack one.")
    poses = poses_of(rows[nearest])
    return poses if align == "none" else aligned_poses(poses, sequence.Ts_world_camera, align)


_SCALE = 3.0 * MM
"""Error at the end of the color scale."""
_WITHIN = 2.0 * MM
"""Distance within which the true wall counts as reconstructed."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of a reconstruction with the true wall.

    Attributes:
        errors: Statistics of its vertices' distances from the true wall.
        completeness: Fraction of the true wall's area within 2 mm of the reconstruction.
        distances: Distance of each vertex [m].
    """

    errors: SurfaceErrors
    completeness: float
    distances: Float[np.ndarray, " n"]


def compare(mesh: Mesh, truth: Mesh) -> Comparison:
    """Compare a reconstruction with the true wall; both in one frame [m].

    Raises:
        InputError: If the reconstruction is empty.
    """
    distances = surface_distances(mesh.vertices, truth)
    corners = truth.vertices[truth.faces]
    is_near = surface_distances(corners.mean(axis=1), mesh) < _WITHIN
    areas = triangle_areas(corners)
    completeness = float(areas[is_near].sum() / areas.sum())
    return Comparison(surface_errors(distances), completeness, distances)


def write_comparison(folder: Path, mesh: Mesh, comparison: Comparison) -> None:
    """Write `errors.csv`, `errors.ply` colored by error, and `errors.png`."""
    row = {**asdict(comparison.errors), "completeness": comparison.completeness}
    write_csv(folder / "errors.csv", [row])
    write_ply(folder / "errors.ply", mesh, error_colors(comparison.distances))
    _write_picture(folder / "errors.png", mesh, comparison)


def error_colors(distances: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """Map errors to colors from blue at 0 to red at 3 mm and more."""
    return (turbo(np.clip(distances / _SCALE, 0.0, 1.0)) * 255).astype(np.uint8)


def write_ply(path: Path, mesh: Mesh, color: UInt8[np.ndarray, "n 3"]) -> None:
    """Write a mesh with colored vertices as binary PLY [m]."""
    trimesh = import_extra("trimesh", "reconstruct")

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=color, process=False)
    data: Any = solid.export(file_type="ply")
    write_bytes(path, data)


def _write_picture(path: Path, mesh: Mesh, comparison: Comparison) -> None:
    """Draw two views of the vertices, colored by error, the nearest in front; and a histogram."""
    ScalarMappable = import_extra(
        "matplotlib.cm", "reconstruct", package="matplotlib"
    ).ScalarMappable
    Normalize = import_extra("matplotlib.colors", "reconstruct", package="matplotlib").Normalize

    fig = make_figure(13.0, 5.0)
    views = fig.subplots(1, 3, width_ratios=[1, 1, 0.7])
    points_mm = mesh.vertices / MM
    for view, (across, up, towards) in zip(views, ((0, 2, 1), (0, 1, 2)), strict=False):
        order = np.argsort(points_mm[:, towards])
        view.scatter(
            points_mm[order, across],
            points_mm[order, up],
            c=comparison.distances[order] / MM,
            cmap="turbo",
            vmin=0.0,
            vmax=_SCALE / MM,
            s=2.5,
            linewidths=0,
            rasterized=True,
        )
        view.set_aspect("equal")
        view.set_xlabel("xyz"[across] + " [mm]")
        view.set_ylabel("xyz"[up] + " [mm]")
    scale = ScalarMappable(Normalize(0.0, _SCALE / MM), "turbo")
    fig.colorbar(scale, ax=views[1], label="error [mm]")
    views[2].hist(comparison.distances / MM, bins=60, range=(0.0, _SCALE / MM), color="#446688")
    views[2].set_xlabel("error [mm]")
    views[2].set_ylabel("vertices")
    fig.suptitle(
        f"RMSE {comparison.errors.rmse / MM:.2f} mm, "
        f"median {comparison.errors.median / MM:.2f} mm, "
        f"95 % below {comparison.errors.percentile_95 / MM:.2f} mm; "
        f"{100.0 * comparison.completeness:.0f} % of the wall within 2 mm"
    )
    with atomic_write(path) as temporary:
        fig.savefig(temporary, format="png", dpi=110)
