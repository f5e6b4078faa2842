"""How the image moves: where surface points seen now appear in a neighbouring frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Contents, Wall
from vrcaps.camera.camera import Camera
from vrcaps.camera.rays import pixel_grid, project_points
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.render.refraction import Bends
from vrcaps.transforms import invert, transform_points
from vrcaps.world.model import State

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

STEP = 4
"""Pixels between those that stand for all, the first in the middle of a square; as in the core."""


@dataclass(frozen=True)
class SurfacePoints:
    """The wall point that each pixel sees, fixed to the wall.

    Attributes:
        position: Place now in the world frame [m]; NaN where there is none.
        face: Face it lies on, −1 where there is none, −2 − k on sphere k of the lumen_contents.
        weights: Weights of the face's first and second corner.
        bend: How a liquid's surface turns the way to it, as in the channel `bend_label`.
    """

    position: Float[np.ndarray, "h w 3"]
    face: Int[np.ndarray, "h w"]
    weights: Float[np.ndarray, "h w 2"]
    bend: UInt8[np.ndarray, "h w"]

    @staticmethod
    def sparse(camera: Camera) -> SurfacePoints:
        """Room for the points that `thinned` pixels of a camera see."""
        half = STEP // 2
        shape = (camera.height + half - 1) // STEP, (camera.width + half - 1) // STEP
        position, weights = np.empty((*shape, 3), np.float32), np.empty((*shape, 2), np.float32)
        bend = np.empty(shape, np.uint8)
        return SurfacePoints(position, np.empty(shape, np.int32), weights, bend)

    def moved(
        self,
        faces: Int[np.ndarray, "m 3"],
        state: State,
        now: LumenContents | None = None,
        then: LumenContents | None = None,
    ) -> Float[np.ndarray, "h w 3"]:
        """The same points of the wall and of spheres in another state, world frame [m].

        Args:
            faces: Of the wall.
            state: The other state.
            now: What is in the lumen now.
            then: What is in it in the other state.

        Returns:
            `position` itself where nothing moves.
        """
        points = self._moved_wall(faces, state)
        if now is None or then is None or not now.spheres.has_chyme:
            return points
        points, afloat = points.astype(float), self.face < -1
        sphere = -2 - self.face[afloat]
        shift = then.spheres.centers[sphere] - now.spheres.centers[sphere]
        points[afloat] = self.position[afloat] + shift
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


def thinned(image: np.ndarray) -> np.ndarray:
    """One pixel of every `STEP` by `STEP`."""
    return image[STEP // 2 :: STEP, STEP // 2 :: STEP]


def flow(
    camera: Camera, points_world: Float[np.ndarray, "h w 3"], state: State
) -> Float[np.ndarray, "h w 2"]:
    """Motion of each pixel's surface point from now to a neighbouring frame [px].

    Args:
        camera: The camera that sees both frames.
        points_world: Where the surface points appear in the neighbouring frame [m].
        state: The neighbouring frame.

    Returns:
        Columns and rows, as float32; NaN where there is no surface or the point leaves the
        lens's field.
    """
    T_camera_world = invert(state.T_world_capsule @ camera.T_capsule_camera)
    pixels = project_points(camera, transform_points(T_camera_world, points_world))
    return (pixels - pixel_grid(camera.width, camera.height)).astype(np.float32)


def seen_from(
    camera: Camera,
    bends: Bends,
    points_world: Float[np.ndarray, "h w 3"],
    motion: Float[np.ndarray, "h w 2"],
    state: State,
    wall: Wall,
    contents: Contents | None,
) -> Bool[np.ndarray, "h w"]:
    """Whether each surface point is seen in a neighbouring frame: in view and not hidden.

    Args:
        camera: The camera that sees both frames.
        bends: How liquid bends the ways to them.
        points_world: The surface points in the neighbouring frame [m].
        motion: Of their images [px].
        state: The neighbouring frame.
        wall: In that frame.
        contents: Of the lumen then.
    """
    target = motion + pixel_grid(camera.width, camera.height)
    size = np.array([camera.width, camera.height])
    seen = np.all((target >= -0.5) & (target < size - 0.5), axis=-1)
    eye = tuple((state.T_world_capsule @ camera.T_capsule_camera)[:3, 3])
    points_world = points_world.astype(float, copy=False)
    ends, is_bent = points_world, np.zeros(seen.shape, bool)
    if bends.turn is not None:
        is_bent = np.isfinite(bends.turn[..., 0])
        ends = np.where(is_bent[..., None], bends.turn, points_world)
    seen &= wall.visible(eye, ends.reshape(-1, 3)).reshape(seen.shape)
    if contents is not None:
        seen &= contents.free(wall, eye, ends.reshape(-1, 3)).reshape(seen.shape)
        seen[is_bent] &= contents.free_ways(wall, ends[is_bent], points_world[is_bent])
    return seen
