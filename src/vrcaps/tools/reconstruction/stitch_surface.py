"""Surface of a stitched image, and its registration to the true wall."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera, pixel_grid
from vrcaps.core.errors import InputError
from vrcaps.core.transforms import transform_points
from vrcaps.mesh.mesh import Mesh
from vrcaps.recording.frame_sequence import CAMERA_POSE
from vrcaps.tools.reconstruction.estimates import network_depth
from vrcaps.tools.reconstruction.icp import Registration, registered
from vrcaps.tools.reconstruction.mosaic import Mosaic
from vrcaps.tools.reconstruction.shading import depth_from_shading
from vrcaps.tools.reconstruction.stitch import Stitched

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.learn.checkpoint import TrainedNetwork

_JUMP = 1.15
"""Ratio of neighboring depths above which they belong to two surfaces."""


@dataclass(frozen=True)
class DepthSource:
    """Source of a stitched image's depth; by default, its frames.

    Attributes:
        weights: File or published name of weights of the task `depth` or `sfm`; empty for none.
        shading: Whether to use shape from shading.
    """

    weights: str = ""
    shading: bool = False


@dataclass(frozen=True)
class WallSurface:
    """Surface in the world frame, or in the reference camera's frame without known poses.

    Attributes:
        mesh: Vertices in [m].
        color: Color of each vertex.
        registration: Registration to the true wall; None if the wall is unknown.
    """

    mesh: Mesh
    color: UInt8[np.ndarray, "n 3"]
    registration: Registration | None


def wall_surface(found: Stitched, source: DepthSource) -> tuple[Stitched, WallSurface]:
    """Build the surface of a stitched image; return it with the image and the depth used.

    Registration starts from the reference's true pose, not the paper's hand-labeled polygon.
    A free scale is set by the median of the frames' own depth, or fitted without it.

    Args:
        found: Result of stitching.
        source: Source of the depth.

    Raises:
        InputError: If there is no depth, or the weights are unsuitable.
        MissingExtraError: If a package is not installed.
    """
    mosaic, sequence = found.mosaic, found.sequence
    depth, has_scale = _depth(mosaic, source)
    if not has_scale and np.isfinite(mosaic.depth).any():
        # A scale fitted to nearest points would shrink a wrong surface onto a part of the wall.
        depth, has_scale = depth * np.nanmedian(mosaic.depth / depth), True
    mesh, color = surface_of(depth, mosaic.rgb, mosaic.camera)
    if CAMERA_POSE in sequence.values:
        pose = sequence.Ts_world_camera[mosaic.reference]
        mesh = replace(mesh, vertices=transform_points(pose, mesh.vertices))
    registration = None
    if sequence.episode is not None:
        mesh, registration = registered(mesh, sequence.episode.organ, scale=not has_scale)
    moved = replace(found, mosaic=replace(mosaic, depth=depth.astype(np.float32)))
    return moved, WallSurface(mesh, color, registration)


def _depth(mosaic: Mosaic, source: DepthSource) -> tuple[Float[np.ndarray, "h w"], bool]:
    """Depth z of the image, and whether it is in meters."""
    if source.shading:
        return depth_from_shading(mosaic.rgb, mosaic.camera), False
    if source.weights:
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.hub import find_weights

        return estimated_depth(read_weights(find_weights(source.weights)), mosaic)
    if not np.isfinite(mosaic.depth).any():
        raise InputError("The frames have no depth. Give --depth, --weights or --shading.")
    return mosaic.depth.astype(float), True


def surface_of(
    depth: Float[np.ndarray, "h w"], rgb: UInt8[np.ndarray, "h w 3"], camera: Camera
) -> tuple[Mesh, UInt8[np.ndarray, "n 3"]]:
    """Triangulate a depth image in the camera frame, with vertex colors.

    Args:
        depth: Depth z [m]; NaN where it is unknown. The surface is cut at discontinuities.
        rgb: Colors.
        camera: Camera of both.

    Raises:
        InputError: If there is no surface.
    """
    height, width = depth.shape
    rays = camera.lens.unproject(pixel_grid(width, height))
    points = rays / rays[..., 2:] * depth[..., None]
    number = np.arange(height * width).reshape(height, width)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, d, b), (b, d, c))])
    corners = depth.ravel()[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    faces = faces[np.isfinite(low) & (low > 0.0) & (high <= _JUMP * low)]
    if not len(faces):
        raise InputError("The stitched image has no surface: its depth is nowhere known.")
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(points.reshape(-1, 3)[used], faces.reshape(-1, 3)), rgb.reshape(-1, 3)[used]


def estimated_depth(
    trained: TrainedNetwork, mosaic: Mosaic
) -> tuple[Float[np.ndarray, "h w"], bool]:
    """Estimate depth z of a stitched image by a network; also return whether it is in meters.

    Args:
        trained: Weights of the task `depth` or, up to scale, `sfm`.
        mosaic: The image.

    Raises:
        InputError: If the weights are of another task.
    """
    depth = network_depth(trained, mosaic.rgb, mosaic.camera)
    return np.where(mosaic.rgb.any(axis=2), depth, np.nan), trained.learner.kind == "depth"
