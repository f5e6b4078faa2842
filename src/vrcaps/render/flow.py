"""Optical flow and visibility of surface points in a neighboring frame, also through pools."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Contents, Wall
from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points
from vrcaps.core.geometry import invert, transform_points
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.render.channels import CHANNELS
from vrcaps.world.model import State

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8


REFLECTED = CHANNELS["refraction_label"].class_names.index("reflected")

_STEPS = 40
"""Maximum number of Newton steps; about five suffice, grazing paths bisect."""


@dataclass(frozen=True)
class RefractedPaths:
    """Light paths from a camera to points through a pool's surface.

    Attributes:
        apparent: Apparent positions of the points: at the distance of the path length, on the
            straight line along which the path leaves the camera; world frame [m].
        surface_crossing: Intersection of the path with the surface [m]; NaN for straight paths,
            None if all paths are straight.
    """

    apparent: Float[np.ndarray, "*n 3"]
    surface_crossing: Float[np.ndarray, "*n 3"] | None


def surface_heights(
    lumen_contents: LumenContents,
    eye: Float[np.ndarray, " 3"],
    wall: Wall,
    faces: Int[np.ndarray, "m 3"],
    face: Int[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """Height of the pool surface between a camera and each point [m]; NaN where there is none.

    For a camera in a pool, this is the surface of that pool, above it. For a camera above the
    liquid, these are the surfaces of the pools that the points belong to.

    Args:
        lumen_contents: Contents of the lumen.
        eye: Position of the camera in the world [m].
        wall: The wall, to find the pool that the camera is in.
        faces: Faces of the wall.
        face: Index of each point's face, −2 − k for sphere k of the lumen contents.
    """
    levels, pools = np.full(face.shape, np.nan), lumen_contents.pools
    if pools is None:
        return levels
    heights = np.append(np.nan, pools.levels)
    nearest = np.asarray(wall.closest_point(eye[None])[1])[0]
    own = heights[pools.of_vertex[faces[nearest]].max()]
    if eye[2] < own:
        levels[...] = own
        return levels
    on_wall = face >= 0
    levels[on_wall] = heights[pools.of_vertex[faces[face[on_wall]]].max(axis=-1)]
    on_sphere = face < -1
    arc_length = lumen_contents.spheres.arc_length[-2 - face[on_sphere]]
    for (start, end), height in zip(pools.stretch, pools.levels, strict=True):
        inside = (arc_length >= start) & (arc_length <= end)
        levels[on_sphere] = np.where(inside, height, levels[on_sphere])
    levels[levels > eye[2]] = np.nan
    return levels


def refract_paths(
    eye: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "*n 3"],
    heights: Float[np.ndarray, "*n"],
    is_reflected: Bool[np.ndarray, "*n"],
    ior: float,
) -> RefractedPaths:
    """Light paths from a camera to points through horizontal liquid surfaces, by Snell's law.

    Args:
        eye: Position of the camera in the world [m].
        points: Points in the world [m].
        heights: Heights of the surface between camera and point [m]; NaN for none.
        is_reflected: Points seen by reflection at the surface, if they are in the liquid like
            the camera.
        ior: Refractive index of the liquid.
    """
    apparent, crossing = points.astype(np.float64), np.full(points.shape, np.nan)
    with np.errstate(invalid="ignore"):
        is_across = (points[..., 2] < heights) != (eye[2] < heights)
        is_across &= np.isfinite(heights) & np.isfinite(points[..., 2])
        is_reflection = is_reflected & ~is_across & (points[..., 2] < heights)
    apparent[is_reflection, 2] = 2.0 * heights[is_reflection] - points[is_reflection][:, 2]
    fraction = (heights[is_reflection] - eye[2]) / (apparent[is_reflection, 2] - eye[2])
    crossing[is_reflection] = eye + fraction[:, None] * (apparent[is_reflection] - eye)
    crossing[is_across] = _crossings(eye, points[is_across], heights[is_across], ior)
    first, second = crossing[is_across] - eye, points[is_across] - crossing[is_across]
    before, after = (np.linalg.norm(leg, axis=-1) for leg in (first, second))
    factor = (before + after) / np.maximum(before, 1e-12)
    apparent[is_across] = eye + factor[:, None] * first
    return RefractedPaths(apparent, crossing)


def _crossings(
    eye: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "n 3"],
    heights: Float[np.ndarray, " n"],
    ior: float,
) -> Float[np.ndarray, "n 3"]:
    """Surface crossings of light paths: the path of least time (Fermat).

    The derivative of time along the line below camera and point is monotonic, so Newton steps stay
    within the bracket.
    """
    offset = points[:, :2] - eye[:2]
    reach = np.linalg.norm(offset, axis=-1)
    near, far = np.abs(eye[2] - heights), np.abs(points[:, 2] - heights)
    index_near, index_far = np.where(eye[2] < heights, (ior,), (1.0,)), 1.0 + 0.0 * heights
    index_far = np.where(eye[2] < heights, index_far, ior)
    low, high = np.zeros_like(reach), reach.copy()
    at = reach * near / np.maximum(near + far, 1e-12)
    for _ in range(_STEPS):
        before, after = np.hypot(at, near) + 1e-15, np.hypot(reach - at, far) + 1e-15
        slope = index_near * at / before - index_far * (reach - at) / after
        low, high = np.where(slope < 0.0, at, low), np.where(slope < 0.0, high, at)
        curve = index_near * near**2 / before**3 + index_far * far**2 / after**3
        newton = at - slope / np.maximum(curve, 1e-12)
        inside = (newton > low) & (newton < high)
        candidate = np.where(inside, newton, 0.5 * (low + high))
        if np.abs(candidate - at).max(initial=0.0) < 1e-12:
            break
        at = candidate
    along = offset * (at / np.maximum(reach, 1e-15))[:, None]
    return np.column_stack([eye[:2] + along, heights])


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
