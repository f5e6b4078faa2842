"""Visibility of a wall from many views without images, and the part that a capsule can see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import camera_rays
from vrcaps.camera.derive import scaled_camera
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.metrics.coverage import CoverageCriteria, CoverageLevel, pixel_solid_angles

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

    from vrcaps.camera.camera import Camera
    from vrcaps.world.model import Model


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


_INDENTATION = 1e-3
"""Maximum indentation of the wall by the capsule [m]."""

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


def coverable(
    model: Model,
    criteria: CoverageCriteria | None = None,
    *,
    spacing: float = 5e-3,
    num_offsets: int = 6,
    num_directions: int = 24,
    width: int = 128,
) -> dict[CoverageLevel, Bool[np.ndarray, " m"]]:
    """Triangles visible to a camera of the capsule from a dense set of poses, by level.

    The wall is at rest. The union over more poses is slightly larger: with twice the directions and
    half the spacing a generated colon gains less than 1 % of its area.

    Args:
        model: Organ and capsule.
        criteria: Criteria of a resolved wall.
        spacing: Spacing of stations along the centerline [m].
        num_offsets: Lateral positions at each station, up to where the capsule touches the wall.
        num_directions: Directions of the capsule's axis at each position.
        width: Columns of rays of each view.
    """
    wall = model.wall
    poses = capsule_poses(
        model, spacing=spacing, num_offsets=num_offsets, num_directions=num_directions
    )
    flags = np.zeros((1, len(model.organ.faces)), np.uint8)
    for camera in model.device.cameras:
        views = ViewCoverage(camera, criteria, width=min(width, camera.width))
        views.mark([wall], poses @ camera.T_capsule_camera, flags)
    return seen_by_level(flags[0])


def capsule_poses(
    model: Model, *, spacing: float, num_offsets: int, num_directions: int
) -> Float[np.ndarray, "n 4 4"]:
    """Compute poses ``Ts_world_capsule`` at which the capsule fits into the wall at rest.

    Args:
        model: Organ and capsule.
        spacing: Spacing of stations along the centerline [m].
        num_offsets: Lateral positions at each station.
        num_directions: Directions of the capsule's axis at each position, uniform over the sphere.
    """
    line, radius = model.organ.centerline, model.device.radius
    stations = np.linspace(0.0, line.length, max(2, math.ceil(line.length / spacing) + 1))
    frames = model.centerline_poses(stations)
    room = np.asarray(model.wall.signed_distance(frames[:, :3, 3].copy()), float) - radius
    # Sunflower pattern: uniform over a disk as wide as the space around the capsule.
    k = np.arange(num_offsets)
    ratio, turn = np.sqrt((k + 0.5) / num_offsets), k * _GOLDEN_ANGLE
    disk = np.stack([ratio * np.cos(turn), ratio * np.sin(turn), np.zeros(num_offsets)], -1)
    local = np.concatenate([np.zeros((1, 3)), disk])[None] * np.maximum(room, 0.0)[:, None, None]
    points = np.concatenate([transform_points(T, p) for T, p in zip(frames, local, strict=True)])
    rotations = _rotations(num_directions)
    poses = transform_from(
        np.tile(rotations, (len(points), 1, 1)), np.repeat(points, len(rotations), axis=0)
    )
    return poses[_fits(model, poses)]


def _rotations(count: int) -> Float[np.ndarray, "count 3 3"]:
    """Rotations whose z axes are evenly distributed on the sphere (Fibonacci lattice)."""
    k = np.arange(count)
    z = 1.0 - (2.0 * k + 1.0) / count
    across = np.sqrt(1.0 - z * z)
    forward = np.stack(
        [across * np.cos(k * _GOLDEN_ANGLE), across * np.sin(k * _GOLDEN_ANGLE), z], -1
    )
    helper = np.where(np.abs(forward[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    right = np.cross(helper, forward)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=-1)


def _fits(model: Model, poses: Float[np.ndarray, "n 4 4"]) -> Bool[np.ndarray, " n"]:
    """Check that the capsule's axis is far enough from the wall at each pose."""
    device = model.device
    half = 0.5 * device.length - device.radius
    steps = np.array([-1.0, -0.5, 0.0, 0.5, 1.0]) * half
    axis = poses[:, None, :3, 3] + steps[:, None] * poses[:, None, :3, 2]
    clearance = np.asarray(model.wall.signed_distance(axis.reshape(-1, 3)), float)
    return np.all(clearance.reshape(axis.shape[:2]) > device.radius - _INDENTATION, axis=1)
