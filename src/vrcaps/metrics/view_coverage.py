"""Visibility of a wall from many views, without images: the batched form of `coverage`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import camera_rays
from vrcaps.camera.derive import scaled_camera
from vrcaps.metrics.coverage import CoverageCriteria, CoverageLevel, pixel_solid_angles

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

    from vrcaps.camera.camera import Camera

_FLAGS: dict[CoverageLevel, int] = {"visible": 1, "resolved": 2}


class ViewCoverage:
    """Camera that marks the triangles visible from poses, at `visible` and `resolved`.

    It casts fewer rays than the camera has pixels; the density of pixels on the wall is still the
    camera's own. Incidence is relative to the flat triangle.

    Example:
        >>> views = ViewCoverage(camera, width=128)
        >>> seen = views.seen([model.wall], Ts_world_camera, len(organ.faces))["visible"]
    """

    def __init__(
        self, camera: Camera, criteria: CoverageCriteria | None = None, width: int | None = None
    ) -> None:
        """Prepare the rays.

        Args:
            camera: The camera.
            criteria: Criteria of a resolved wall.
            width: Columns of rays; rows follow from the image's aspect. None: one ray per pixel.
        """
        self.criteria = criteria or CoverageCriteria()
        sampled = camera if width is None else scaled_camera(camera, width / camera.width)
        solid_angles = pixel_solid_angles(sampled) * (sampled.width * sampled.height)
        solid_angles /= camera.width * camera.height
        density = np.nan_to_num(1.0 / solid_angles, posinf=0.0)
        self._rays = _core.RayTable(camera_rays(sampled))
        self._density = np.ascontiguousarray(density, np.float32)

    def mark(
        self,
        walls: Sequence[_core.Wall],
        Ts_world_camera: Float[np.ndarray, "n 4 4"],
        flags: np.ndarray,
    ) -> None:
        """Set bit 0 of the triangles that are visible and bit 1 of those resolved.

        Args:
            walls: One for all poses, or one per pose.
            Ts_world_camera: Poses of the camera in the frame of the walls.
            flags: Flags of each triangle, uint8 [n m]; [1 m] combines all poses. Bits already
                set stay set.

        Raises:
            ValueError: If the array sizes do not match or a pose is not finite.
        """
        _core.mark_seen(
            walls,
            self._rays,
            self._density,
            np.ascontiguousarray(Ts_world_camera, float),
            flags,
            min_density=self.criteria.min_pixel_density,
            min_cosine=math.cos(self.criteria.max_incidence),
        )

    def seen(
        self,
        walls: Sequence[_core.Wall],
        Ts_world_camera: Float[np.ndarray, "n 4 4"],
        num_faces: int,
    ) -> dict[CoverageLevel, Bool[np.ndarray, " m"]]:
        """Triangles visible from any of the poses, by level; arguments as in `mark`."""
        flags = np.zeros((1, num_faces), np.uint8)
        self.mark(walls, Ts_world_camera, flags)
        return seen_by_level(flags[0])


def seen_by_level(flags: UInt8[np.ndarray, " m"]) -> dict[CoverageLevel, Bool[np.ndarray, " m"]]:
    """Triangles seen, by level, from flags set by `ViewCoverage.mark`."""
    return {level: (flags & bit) != 0 for level, bit in _FLAGS.items()}
