"""Optical flow and visibility of surface points in a neighboring frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Contents, Wall
from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points
from vrcaps.core.geometry import invert, transform_points
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.render.refraction import RefractedPaths
from vrcaps.world.model import State

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

SUBSAMPLE = 4
"""Stride of the subsampled pixel grid, which starts at the center of a cell; as in the core."""


@dataclass(frozen=True)
class SurfacePoints:
    """Surface point that each pixel sees, in material coordinates of the wall.

    Attributes:
        position: Position in the world frame now [m]; NaN if there is no surface.
        face: Index of the face it lies on, −1 for none, −2 − k for sphere k of the lumen
            contents.
        weights: Weights of the face's first and second corner.
        refraction: Refraction at a pool's surface, as in the channel `refraction_label`.
    """

    position: Float[np.ndarray, "h w 3"]
    face: Int[np.ndarray, "h w"]
    weights: Float[np.ndarray, "h w 2"]
    refraction: UInt8[np.ndarray, "h w"]

    @staticmethod
    def allocate(camera: Camera) -> SurfacePoints:
        """Uninitialized arrays for the surface points of a camera's `subsample` pixels."""
        half = SUBSAMPLE // 2
        shape = (camera.height + half - 1) // SUBSAMPLE, (camera.width + half - 1) // SUBSAMPLE
        position, weights = np.empty((*shape, 3), np.float32), np.empty((*shape, 2), np.float32)
        refraction = np.empty(shape, np.uint8)
        return SurfacePoints(position, np.empty(shape, np.int32), weights, refraction)

    def moved(
        self,
        faces: Int[np.ndarray, "m 3"],
        state: State,
        now: LumenContents | None = None,
        then: LumenContents | None = None,
    ) -> Float[np.ndarray, "h w 3"]:
        """Positions of these points of wall and spheres in another state, world frame [m].

        Args:
            faces: Faces of the wall.
            state: The other state.
            now: Lumen contents now.
            then: Lumen contents in the other state.

        Returns:
            `position` itself if nothing moves.
        """
        points = self._moved_wall(faces, state)
        if now is None or then is None or not now.spheres.has_chyme:
            return points
        points, on_sphere = points.astype(float), self.face < -1
        sphere = -2 - self.face[on_sphere]
        shift = then.spheres.centers[sphere] - now.spheres.centers[sphere]
        points[on_sphere] = self.position[on_sphere] + shift
        return points

    def _moved_wall(
        self, faces: Int[np.ndarray, "m 3"], state: State
    ) -> Float[np.ndarray, "h w 3"]:
        if state.vertices_world is None:
            return self.position
        corners = state.vertices_world[faces[self.face]]
        first, second = self.weights[..., :1], self.weights[..., 1:]
        return (
            corners[..., 0, :] * first
            + corners[..., 1, :] * second
            + corners[..., 2, :] * (1.0 - first - second)
        )


def subsample(image: np.ndarray) -> np.ndarray:
    """Image on the subsampled pixel grid: one pixel per `SUBSAMPLE` by `SUBSAMPLE` cell."""
    return image[SUBSAMPLE // 2 :: SUBSAMPLE, SUBSAMPLE // 2 :: SUBSAMPLE]


def flow(
    camera: Camera, points_world: Float[np.ndarray, "h w 3"], state: State
) -> Float[np.ndarray, "h w 2"]:
    """Optical flow of each pixel's surface point to a neighboring frame [px].

    Args:
        camera: The camera that sees both frames.
        points_world: Apparent positions of the surface points in the neighboring frame [m].
        state: The neighboring frame.

    Returns:
        Shifts along columns and rows, float32; NaN where there is no surface or the point leaves
        the field of view of the lens.
    """
    T_camera_world = invert(state.T_world_capsule @ camera.T_capsule_camera)
    pixels = project_points(camera, transform_points(T_camera_world, points_world))
    return (pixels - pixel_grid(camera.width, camera.height)).astype(np.float32)


def visibility(
    camera: Camera,
    paths: RefractedPaths,
    points_world: Float[np.ndarray, "h w 3"],
    motion: Float[np.ndarray, "h w 2"],
    state: State,
    wall: Wall,
    contents: Contents | None,
) -> Bool[np.ndarray, "h w"]:
    """Visibility of surface points in a neighboring frame: in view and not occluded.

    Args:
        camera: The camera that sees both frames.
        paths: Light paths to the points through liquid.
        points_world: Positions of the surface points in the neighboring frame [m].
        motion: Optical flow of their images [px].
        state: The neighboring frame.
        wall: The wall in that frame.
        contents: Lumen contents in that frame.
    """
    target = motion + pixel_grid(camera.width, camera.height)
    seen = in_image(camera, target)
    eye = tuple((state.T_world_capsule @ camera.T_capsule_camera)[:3, 3])
    points_world = points_world.astype(float, copy=False)
    ends, is_refracted = points_world, np.zeros(seen.shape, bool)
    if paths.surface_crossing is not None:
        is_refracted = np.isfinite(paths.surface_crossing[..., 0])
        ends = np.where(is_refracted[..., None], paths.surface_crossing, points_world)
    seen &= wall.visible(eye, ends.reshape(-1, 3)).reshape(seen.shape)
    if contents is not None:
        seen &= contents.free(wall, eye, ends.reshape(-1, 3)).reshape(seen.shape)
        starts, points = ends[is_refracted], points_world[is_refracted]
        seen[is_refracted] &= contents.segments_unoccluded(wall, starts, points)
    return seen
