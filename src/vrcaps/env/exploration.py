"""Map that a capsule builds itself, from its estimated pose and the distances that its camera sees.

The map divides space into voxels. A ray of the camera adds evidence for a free voxel along its way
and for a wall at its end (occupancy grid: Elfes, Computer 22, 1989). A voxel that no ray has
reached is unknown; the borders of free and unknown space are the frontiers of exploration
(Yamauchi, CIRA 1997). A view is rated by the unknown space that its rays would reach through free
voxels (Bircher et al., ICRA 2016).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import camera_rays
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import rotate_vectors, unit
from vrcaps.core.units import CM, MM
from vrcaps.env.cameras import distance_noise, resized_camera
from vrcaps.env.observations import located_capsules
from vrcaps.env.parts import EnvView, Observation
from vrcaps.sensors.tracking import TrackingSensors

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.capsule.device import Device

VOXEL = 5.0 * MM
"""Edge of a voxel [m]."""

_SIDE = 64
"""Voxels along each edge of a map: 32 cm."""

_FREE, _WALL, _MOST = -1, 3, 12
"""Evidence of a passing ray and of the end of a ray; limit of the sum."""

_NUM_DIRECTIONS = 256
_VIEW_ANGLE = np.radians(80.0)
"""Half the field of view that is assumed for a planned view [rad]."""

_REACH = 12.0e-2
"""Distance up to which a view counts unknown space [m]."""


def _sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Evenly spread directions, on a spiral of the golden angle."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])


DIRECTIONS = _sphere(_NUM_DIRECTIONS)
HEADINGS = unit(np.array([v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)], float) - 1.0)
"""Viewing directions that are rated: along axes, edges and corners of a cube."""

_IN_VIEW = np.cos(_VIEW_ANGLE) < HEADINGS @ DIRECTIONS.T


class VoxelMap:
    """Evidence for free and occupied voxels around an origin.

    Attributes:
        evidence: Sum of evidence of each voxel, negative for free ones; 0 is unknown [s s s].
        tries: Number of completed views that should have shown each unknown voxel [s s s].
    """

    shape = (_SIDE,) * 3

    def __init__(self, evidence: np.ndarray | None = None, tries: np.ndarray | None = None) -> None:
        """Start with unknown space, or with the arrays of a map, which are changed in place."""
        self.evidence = np.zeros(self.shape, np.int8) if evidence is None else evidence
        self.tries = np.zeros(self.shape, np.uint8) if tries is None else tries

    def add(
        self,
        origin: Float[np.ndarray, " 3"],
        rays: Float[np.ndarray, "n 3"],
        distances: Float[np.ndarray, " n"],
    ) -> None:
        """Add the distances of an image.

        Args:
            origin: Position of the camera, relative to the map's origin [m].
            rays: Unit rays in the axes of the map.
            distances: Distance of the wall along each [m]; 0 for none.
        """
        is_seen = distances > 0.0
        rays, distances = rays[is_seen], distances[is_seen]
        steps = np.arange(0.0, float(distances.max(initial=0.0)), 0.7 * VOXEL)
        is_before = steps < distances[:, None] - 0.8 * VOXEL
        ray, step = np.nonzero(is_before)
        free = self._flat(origin + steps[step, None] * rays[ray])
        ends = self._flat(origin + (distances[:, None] + 0.2 * VOXEL) * rays)
        change = np.zeros(self.evidence.size, np.int8)
        change[free] = _FREE
        change[ends] = _WALL
        total = self.evidence.reshape(-1)
        np.clip(total + change, -_MOST, _MOST, out=total)

    def index(self, points: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, "*n 3"]:
        """Voxels that contain points [m], clamped to the map."""
        cells = np.floor(np.asarray(points) / VOXEL).astype(np.int64) + _SIDE // 2
        return cells.clip(0, _SIDE - 1)

    @staticmethod
    def center(cells: Int[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Centers of voxels [m]."""
        return (np.asarray(cells) - _SIDE // 2 + 0.5) * VOXEL

    def _flat(self, points: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, " *n"]:
        cells = self.index(points)
        return (cells[..., 0] * _SIDE + cells[..., 1]) * _SIDE + cells[..., 2]

    @property
    def is_free(self) -> Bool[np.ndarray, "s s s"]:
        """Whether voxels are free."""
        return self.evidence < 0

    def cast(
        self, origins: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n k"], Int[np.ndarray, "n k"], Bool[np.ndarray, "n k"]]:
        """First voxel that is not free along each of `DIRECTIONS`.

        Args:
            origins: Positions [m].

        Returns:
            Distances [m], flat indices of the voxels, and whether they are unknown.
        """
        steps = np.arange(1, int(_REACH / VOXEL)) * VOXEL
        points = origins[:, None, None] + steps[:, None] * DIRECTIONS[:, None]
        cells = self._flat(points)
        evidence = self.evidence.reshape(-1)[cells]
        is_end = evidence >= 0
        first = is_end.argmax(axis=-1)
        last = np.take_along_axis(cells, first[..., None], axis=-1)[..., 0]
        value = np.take_along_axis(evidence, first[..., None], axis=-1)[..., 0]
        return steps[first], last, is_end.any(axis=-1) & (value == 0)

    def gains(self, origins: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n h"]:
        """Area of unknown space that views along `HEADINGS` would reach [m²].

        Voxels that completed views have not shown count less.

        Args:
            origins: Positions of the camera [m].
        """
        distance, cells, is_unknown = self.cast(origins)
        known = 1.0 + self.tries.reshape(-1)[cells].astype(float)
        area = 4.0 * np.pi / _NUM_DIRECTIONS * distance**2 * is_unknown / known**2
        return area @ _IN_VIEW.T

    def complete(self, origin: Float[np.ndarray, " 3"], heading: Float[np.ndarray, " 3"]) -> None:
        """Record a completed view: voxels that it left unknown count less in later views.

        Args:
            origin: Position of the camera [m].
            heading: Its viewing direction.
        """
        _, cells, is_unknown = self.cast(origin[None])
        is_in_view = DIRECTIONS @ heading > np.cos(_VIEW_ANGLE)
        tries = self.tries.reshape(-1)
        cells = np.unique(cells[0, is_unknown[0] & is_in_view])
        tries[cells] = np.minimum(tries[cells], 200) + 1


_CLIMB = 2
"""Maximum difference of height between neighboring floor voxels."""


def floor_paths(
    known: VoxelMap, start: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Callable[[np.ndarray], np.ndarray]]:
    """Positions on the lower wall of the mapped space that a capsule reaches from a start.

    Args:
        known: The map.
        start: Position of the capsule [m].

    Returns:
        Positions [m], lengths of the shortest paths to them [m], and a function that gives the
        path [m 3] to one of the positions.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    free = known.is_free
    floor = np.where(free.any(axis=2), free.argmax(axis=2), -1)
    columns = np.argwhere(floor >= 0)
    if len(columns) == 0:
        return np.zeros((0, 3)), np.zeros(0), lambda _: start[None]
    heights = floor[columns[:, 0], columns[:, 1]]
    points = known.center(np.column_stack([columns, heights]))
    node = np.full(floor.shape, -1)
    node[columns[:, 0], columns[:, 1]] = np.arange(len(columns))
    ends = []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        other = node[(columns[:, 0] + dx) % _SIDE, (columns[:, 1] + dy) % _SIDE]
        is_edge = (other >= 0) & (np.abs(heights - heights[other]) <= _CLIMB)
        ends.append(np.column_stack([np.flatnonzero(is_edge), other[is_edge]]))
    rows, others = np.concatenate(ends).T
    lengths = np.linalg.norm(points[rows] - points[others], axis=1)
    graph = coo_array((lengths, (rows, others)), shape=(len(points),) * 2).tocsr()
    first = int(np.sum((points - start) ** 2, axis=1).argmin())
    distance, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    is_reached = np.flatnonzero(np.isfinite(distance))

    def path_to(end: np.ndarray) -> np.ndarray:
        at = is_reached[int(np.sum((points[is_reached] - end) ** 2, axis=1).argmin())]
        nodes = [at]
        while before[nodes[-1]] >= 0:
            nodes.append(before[nodes[-1]])
        return np.concatenate([start[None], points[nodes[::-1]]])

    return points[is_reached], distance[is_reached], path_to


_SIZE = (24, 24)
_TRY_PERIOD = 1.0
"""Time between views that count as completed [s]."""

_BLOCK = 8
"""Voxels along the edge of a block, in which frontiers are summed."""

_NUM_BLOCKS = 3
_AREA, _DISTANCE, _COUNT, _VOLUME = 10.0 * CM**2, 20.0 * MM, 50.0, 2000.0
_KEY = "exploration/{}"
_NEAREST = (HEADINGS @ DIRECTIONS.T).argmax(axis=1)


@dataclass(frozen=True)
class ExplorationObservation(Observation):
    """Unknown space in a map that the capsule builds itself, see `VoxelMap`.

    The map is built from the pose that a tracker estimates and from distances with noise, which
    stand for depth estimated from color. A magnitude d is encoded as d / (d + scale); vectors are
    in the world frame. In this order:

    - for each of the 26 directions to faces, edges and corners of a cube: area of unknown space
      that a view there would show (10 cm²), then the distance to the first voxel that is not free
      (20 mm) (52)
    - for each of the three blocks of 4 cm with the largest frontiers per distance: direction (3),
      distance (20 mm), number of free voxels next to unknown ones (50) (5 per block); 0 if none
    - number of free voxels (2000)

    Attributes:
        sensors: Sensors of the tracker; those of `StateObservation(pose="located")` if it is
            observed as well.
        noise: Error of the distances, see `ImageObservation`.
    """

    sensors: TrackingSensors = field(default_factory=TrackingSensors)
    noise: Annotated[float, Range(min=0.0, max=1.0)] = 0.05

    kind: ClassVar[str] = "exploration"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, view: EnvView) -> Any:
        """Observation space: values from −1 to 1."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, (2 * len(HEADINGS) + 5 * _NUM_BLOCKS + 1,), np.float32)

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each value; a magnitude d is encoded as d/(d + the unit in brackets)."""
        names = [f"unknown_{k} [10 cm²]" for k in range(len(HEADINGS))]
        names += [f"free_{k} [20 mm]" for k in range(len(HEADINGS))]
        for k in range(_NUM_BLOCKS):
            names += [f"frontier_{k}_{axis} [1]" for axis in "xyz"]
            names += [f"frontier_{k}_distance [20 mm]", f"frontier_{k}_size [50]"]
        return (*names, "free_voxels [2000]")

    def allocate(self, view: EnvView) -> None:
        """Allocate the maps.

        Raises:
            InputError: If the capsule has no magnet for localization.
        """
        memory = view.memory
        located_capsules(view, self.sensors, self.kind)
        memory.allocate(_KEY.format("evidence"), VoxelMap.shape, np.int8)
        memory.allocate(_KEY.format("tries"), VoxelMap.shape, np.uint8)
        memory.allocate(_KEY.format("origin"), (3,))
        memory.allocate(_KEY.format("seed"), dtype=np.int64)
        memory.allocate(_KEY.format("time"), fill=-1.0)
        memory.allocate(_KEY.format("completed"))

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Start with unknown space around the organ's center."""
        memory, vertices = view.memory, view.patient(index).model.vertices_world
        located_capsules(view, self.sensors, self.kind).begin(index, rng, self.kind)
        for name, value in (("evidence", 0), ("tries", 0), ("time", -1.0), ("completed", 0.0)):
            memory[_KEY.format(name)][index] = value
        center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        memory[_KEY.format("origin")][index] = center
        memory[_KEY.format("seed")][index] = rng.integers(2**31)

    def observe(self, view: EnvView) -> Float[np.ndarray, "n k"]:
        """Return the features of all worlds, after adding an image to each map."""
        located = located_capsules(view, self.sensors, self.kind)
        located.read()
        camera = view.device.cameras[0]
        T_camera = located.Ts_world_capsule @ camera.T_capsule_camera
        eyes = T_camera[:, :3, 3] - view.memory[_KEY.format("origin")]
        rows = []
        for index, T in enumerate(located.Ts_world_capsule):
            known = self._map(view, index, eyes[index], T[:3, :3])
            rows.append(_features(known, eyes[index]))
        return np.array(rows).clip(-1.0, 1.0).astype(np.float32)

    def _map(self, view: EnvView, index: int, eye: np.ndarray, rotation: np.ndarray) -> VoxelMap:
        """Map of one world, with the image of the current time."""
        memory, time = view.memory, float(view.time[index])
        known = VoxelMap(*(memory[_KEY.format(name)][index] for name in ("evidence", "tries")))
        if memory[_KEY.format("time")][index] == time:
            return known
        memory[_KEY.format("time")][index] = time
        seed = int(memory[_KEY.format("seed")][index])
        rays, distances = _distances(view, index)
        distances = distance_noise(distances, self.noise, seed, time)
        known.add(eye, rays @ rotation.T, distances)
        if time >= memory[_KEY.format("completed")][index] + _TRY_PERIOD:
            memory[_KEY.format("completed")][index] = time
            known.complete(eye, rotation[:, 2])
        return known


def image_rays(device: Device, size: tuple[int, int]) -> Float[np.ndarray, "n 3"]:
    """Unit rays of the pixels of an `ImageObservation` of the first camera, in the capsule's axes.

    NaN outside the field of view.

    Args:
        device: The capsule.
        size: Height and width of the image [px].
    """
    camera = device.cameras[0]
    rays = camera_rays(resized_camera(camera, *size)).reshape(-1, 3).astype(float)
    return rays @ camera.T_capsule_camera[:3, :3].T


def _distances(
    view: EnvView, index: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Rays of the first camera in the capsule's axes, and true distances along them [m]."""
    rays = image_rays(view.device, _SIZE)
    rays = rays[np.isfinite(rays).all(axis=1)]
    T = view.T_patient_world @ view.T_world_capsule[index]
    ways, eye = rotate_vectors(T, rays), T @ view.device.cameras[0].T_capsule_camera
    wall = view.batch.worlds[index].wall
    (distances,) = _core.wall_distances([wall], eye[None, :3, 3], ways[None], _FARTHEST)
    return rays, np.where(distances < _FARTHEST, distances, 0.0).astype(float)


_FARTHEST = 0.3
"""Distance beyond which a camera sees no wall [m]."""


def _features(known: VoxelMap, here: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " k"]:
    """Values of the observation for a camera at a position in the map."""
    distance, _, _ = known.cast(here[None])
    gains, free = known.gains(here[None])[0], distance[0, _NEAREST]
    is_free = known.is_free
    is_unknown = known.evidence == 0
    near = np.zeros(known.shape, bool)
    for axis in range(3):
        for step in (-1, 1):
            near |= np.roll(is_unknown, step, axis)
    frontier = (is_free & near).reshape((_SIDE // _BLOCK, _BLOCK) * 3).sum(axis=(1, 3, 5))
    blocks = np.argwhere(frontier > 0)
    counts = frontier[tuple(blocks.T)].astype(float)
    offsets = known.center(_BLOCK * blocks + _BLOCK // 2) - here
    ways = np.linalg.norm(offsets, axis=1)
    best = np.argsort(-counts / (ways + _DISTANCE), kind="stable")[:_NUM_BLOCKS]
    rows = np.zeros((_NUM_BLOCKS, 5))
    rows[: len(best), :3] = offsets[best] / np.maximum(ways[best], MM)[:, None]
    rows[: len(best), 3] = _soft(ways[best], _DISTANCE)
    rows[: len(best), 4] = _soft(counts[best], _COUNT)
    volume = _soft(np.array([float(is_free.sum())]), _VOLUME)
    return np.concatenate([_soft(gains, _AREA), _soft(free, _DISTANCE), rows.ravel(), volume])


def _soft(value: np.ndarray, scale: float) -> np.ndarray:
    return value / (value + scale)
