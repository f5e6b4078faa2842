"""Fusion of depth and poses into a surface, by truncated signed distances in sparse blocks.

Each view updates the distance of a voxel by a running mean (Curless and Levoy, SIGGRAPH 1996).
Only blocks near the wall are stored (Nießner et al., ACM TOG 32(6), 2013). Distances are along
the camera rays, so any lens model works.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import Camera, in_image, pixel_grid, project_points, unproject_pixels
from vrcaps.core.errors import InputError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import invert, transform_points
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, UInt8

_SIDE = 8
"""Voxels along a block's side."""
_TRUNCATION = 4.0
"""Truncation distance [voxels]."""
_MAX_VOXELS = 4 * 10**8
"""Maximum size of the box around all blocks, which marching cubes needs as a whole."""


class Volume:
    """Signed distance to the wall, positive in the lumen, and color, in the observed region."""

    def __init__(self, voxel: float) -> None:
        """Create an empty volume.

        Args:
            voxel: Side of a voxel [m].

        Raises:
            InputError: If it is not positive.
        """
        require(0.0 < voxel < np.inf, "voxel", voxel, "above 0 m")
        self.voxel = voxel
        self._slots: dict[tuple[int, int, int], int] = {}
        self._distance = np.zeros((0, _SIDE**3), np.float32)
        self._weight = np.zeros((0, _SIDE**3), np.float32)
        self._color = np.zeros((0, _SIDE**3, 3), np.float32)
        corner = np.stack(np.meshgrid(*[np.arange(_SIDE)] * 3, indexing="ij"), axis=-1)
        self._inner = corner.reshape(-1, 3)

    def __len__(self) -> int:
        """Number of blocks."""
        return len(self._slots)

    def add(
        self,
        camera: Camera,
        T_world_camera: Float[np.ndarray, "4 4"],
        distance: Float[np.ndarray, "h w"],
        rgb: UInt8[np.ndarray, "h w 3"],
    ) -> None:
        """Fuse one view.

        Args:
            camera: Camera of the view.
            T_world_camera: Its pose.
            distance: Distance of the wall along each pixel's ray [m]; NaN for none.
            rgb: Color image of the view.
        """
        keys = self._blocks_near(camera, T_world_camera, distance)
        if not len(keys):
            return
        slots = self._slots_of(keys)
        centers = (keys[:, None] * _SIDE + self._inner + 0.5) * self.voxel
        points = transform_points(invert(T_world_camera), centers.reshape(-1, 3))
        pixels = project_points(camera, points)
        seen = in_image(camera, pixels)
        column, row = np.rint(np.where(seen[:, None], pixels, 0.0)).astype(int).T
        there = distance[row, column] - np.linalg.norm(points, axis=1)
        limit = _TRUNCATION * self.voxel
        # Voxels further behind the wall are occluded, not observed.
        counts = seen & np.isfinite(there) & (there > -limit)
        value = np.minimum(np.where(counts, there, 0.0), limit) / limit
        self._blend(slots, counts, value, rgb[row, column])

    def _blend(
        self, slots: np.ndarray, counts: np.ndarray, value: np.ndarray, rgb: np.ndarray
    ) -> None:
        shape = (len(slots), _SIDE**3)
        add = counts.reshape(shape).astype(np.float32)
        weight = self._weight[slots] + add
        step = np.divide(add, weight, out=np.zeros_like(weight), where=weight > 0)
        self._distance[slots] += step * (value.reshape(shape) - self._distance[slots])
        color = rgb.reshape(*shape, 3)
        self._color[slots] += step[..., None] * (color - self._color[slots])
        self._weight[slots] = weight

    def _blocks_near(
        self, camera: Camera, T_world_camera: np.ndarray, distance: np.ndarray
    ) -> Int[np.ndarray, "k 3"]:
        """Indices of the blocks within the truncation distance of a view's surface, sorted."""
        is_seen = np.isfinite(distance)
        pixels = pixel_grid(camera.width, camera.height)[is_seen]
        rays, reach = unproject_pixels(camera, pixels), distance[is_seen]
        if not len(reach):
            return np.zeros((0, 3), np.int64)
        limit = _TRUNCATION * self.voxel
        steps = np.arange(-limit, limit + 1e-12, 0.5 * _SIDE * self.voxel)
        samples = [
            transform_points(T_world_camera, rays * (reach + step)[:, None]) for step in steps
        ]
        keys = np.floor(np.concatenate(samples) / (_SIDE * self.voxel)).astype(np.int64)
        # One integer key per block: sorting rows takes ten times as long.
        low, span = keys.min(axis=0), np.ptp(keys, axis=0) + 1
        packed = np.unique(np.ravel_multi_index(tuple((keys - low).T), tuple(span)))
        return np.stack(np.unravel_index(packed, tuple(span)), axis=-1) + low

    def _slots_of(self, keys: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
        """Slots of blocks in the arrays; missing ones are allocated."""
        for key in map(tuple, keys.tolist()):
            self._slots.setdefault(key, len(self._slots))
        missing = len(self._slots) - len(self._distance)
        if missing > 0:
            room = max(missing, len(self._distance))  # doubling, for amortized constant cost
            for name in ("_distance", "_weight", "_color"):
                array = getattr(self, name)
                more = np.zeros((room, *array.shape[1:]), np.float32)
                setattr(self, name, np.concatenate([array, more]))
        return np.array([self._slots[key] for key in map(tuple, keys.tolist())])

    def surface(self, min_views: int = 1) -> tuple[Mesh, UInt8[np.ndarray, "n 3"]]:
        """Extract the zero surface, with vertex colors (marching cubes).

        Args:
            min_views: Minimum number of views for a voxel to count.

        Raises:
            InputError: If nothing was fused, or the box around it is too large.
        """
        marching_cubes = import_extra(
            "skimage.measure", "reconstruct", package="scikit-image"
        ).marching_cubes

        if not self._slots:
            raise InputError("There is no depth to fuse: no frame sees a wall.")
        keys = np.array(list(self._slots))
        low = keys.min(axis=0)
        blocks = keys.max(axis=0) - low + 1
        if np.prod(blocks.astype(float)) * _SIDE**3 > _MAX_VOXELS:
            size = ", ".join(f"{side:.3f}" for side in blocks * _SIDE * self.voxel)
            raise InputError(
                f"The seen wall spans {size} m: too much for voxels of {1e3 * self.voxel:.3g} mm. "
                "Give a larger --voxel."
            )
        distance, weight = (
            self._dense(self._distance, low, blocks),
            self._dense(self._weight, low, blocks),
        )
        is_known = weight >= min_views
        if not (distance[is_known].min(initial=1.0) < 0.0 < distance[is_known].max(initial=-1.0)):
            raise InputError("No surface could be extracted: depths and poses are inconsistent.")
        places, faces, _, _ = marching_cubes(distance, 0.0, mask=_whole_cubes(is_known))
        vertices = (places + 0.5 + low * _SIDE) * self.voxel
        nearest = np.rint(places).astype(int)
        color = self._dense(self._color, low, blocks)[tuple(nearest.T)]
        return Mesh(vertices, faces.astype(np.int64)), np.clip(color, 0, 255).astype(np.uint8)

    def _dense(
        self, values: np.ndarray, low: np.ndarray, blocks: np.ndarray
    ) -> Float32[np.ndarray, "i j k *c"]:
        """Values of all blocks in one dense box; 0 where there is no block."""
        more = values.shape[2:]
        box = np.zeros((*blocks, _SIDE, _SIDE, _SIDE, *more), np.float32)
        keys = np.array(list(self._slots))  # in slot order
        box[tuple((keys - low).T)] = values[: len(keys)].reshape(-1, _SIDE, _SIDE, _SIDE, *more)
        order = (0, 3, 1, 4, 2, 5, *range(6, box.ndim))
        return box.transpose(order).reshape(*(blocks * _SIDE), *more)


def _whole_cubes(is_known: Bool[np.ndarray, "i j k"]) -> Bool[np.ndarray, "i j k"]:
    """Cubes of eight known voxels, at their last corner as marching cubes expects."""
    whole = is_known.copy()
    for axis in range(3):
        before = np.roll(whole, 1, axis)
        before[(slice(None),) * axis + (0,)] = False
        whole &= before
    return whole


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
    progress: ProgressReport = no_report,
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
        raise InputError(f"{sequence.name} has no calibrated camera, which fusion requires.")
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
