"""Fusion of the depth and poses of a run into one surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import pixel_grid, unproject_pixels
from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.reconstruction.volume import Volume

if TYPE_CHECKING:
    from jaxtyping import UInt8

MIN_COSINE = 0.05
"""Minimum cosine of a ray to the axis: near 90°, depth along the axis does not give distance."""


@dataclass(frozen=True)
class FuseSettings:
    """Settings of the fusion.

    Attributes:
        voxel: Side of a voxel [m].
        max_distance: Distance beyond which depth is ignored [m].
        min_views: Minimum number of views of a voxel.
    """

    voxel: Annotated[float, Range(above=0.0)] = 1.0 * MM
    max_distance: Annotated[float, Range(above=0.0)] = 80.0 * MM
    min_views: Annotated[int, Range(1)] = 2

    def __post_init__(self) -> None:
        check_fields(self)


def fuse(
    sequence: FrameSequence,
    settings: FuseSettings,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Mesh, UInt8[np.ndarray, "n 3"]]:
    """Reconstruct the wall seen by a camera, in the world frame, with vertex colors.

    Args:
        sequence: Images, camera, depth and poses.
        settings: Settings of the fusion.
        progress: Called with the number of frames done and the total.

    Raises:
        InputError: If depth, poses or the camera are missing, or there is no surface.
    """
    camera = sequence.camera
    if camera is None:
        raise InputError(f"Fusing depth needs a calibrated camera, which {sequence.name} has not.")
    poses = sequence.Ts_world_camera
    cosine = unproject_pixels(camera, pixel_grid(camera.width, camera.height))[..., 2]
    cosine = np.where(cosine > MIN_COSINE, cosine, np.nan)
    volume = Volume(settings.voxel)
    for index in range(len(sequence)):
        distance = sequence.image("depth", index) / cosine
        distance = np.where(distance <= settings.max_distance, distance, np.nan)
        volume.add(camera, poses[index], distance, sequence.image("rgb", index))
        progress(index + 1, len(sequence))
    return volume.surface(settings.min_views)
