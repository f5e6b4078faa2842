"""Landmark observation: the gut's direction, its wall, and the main unseen regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps import _core
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import rotate_vectors, transform_points
from vrcaps.core.units import CM, MM
from vrcaps.env.parts import EnvView, Observation

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.worlds import CoursePoint

_DISTANCE = 20.0 * MM
_FAR = 10.0 * CM
_AREA = 0.01
_SPEED, _SPIN, _FORCE = 20.0 * MM, 1.0, 0.1
_AHEAD = 4.0 * CM
_REACH = 0.5
_HIDDEN = 5.0 * MM
"""Minimum distance of the wall in front of a region's center that occludes it."""
_NEAREST = 1.0 * CM
_PARTS = (16, 8)
"""Maximum number of regions along the gut and around it."""

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)
RAYS = np.concatenate([np.eye(3), -np.eye(3), _CORNERS])
"""Directions of the wall distances: ±x, ±y, ±z, and the corners of a cube."""


@dataclass(frozen=True)
class LandmarksObservation(Observation):
    """Navigation features with the same number and meaning in every organ.

    A distance d is encoded as d / (d + 20 mm), and other magnitudes likewise, so that all values
    are between −1 and 1. Directions are unit vectors in the chosen frame. In this order:

    - fraction of the gut's course behind the capsule, and elapsed fraction of the episode (2)
    - fraction of the wall seen at `frustum`, `visible`, `resolved` (3)
    - vector to the centerline (20 mm), its tangent there, and the direction to its point 40 mm
      ahead towards the anal end (9); its distance to the wall there (1)
    - direction of gravity; in the world frame that of the capsule's axis +z (3)
    - velocity (20 mm/s), angular velocity (1 rad/s) and contact force (0.1 N) (9)
    - distances to the wall along `RAYS` (14)
    - for each of the top-ranked unseen regions: direction (3), distance, distance along the gut,
      positive towards the anal end (10 cm), unseen fraction of the whole wall (0.01), and whether
      no wall occludes it (7 per region); all 0 if nothing is left to see
    - with an external magnet: vector to it (10 cm) and direction of its moment (6)
    - with the task Navigate: distance along the gut to the goal, positive towards the anal end
      (10 cm)

    A region is a sixteenth of the gut's length by an eighth of its circumference. Regions are
    ranked by their unseen area over their distance, or over the distance along the gut if that is
    longer.

    Attributes:
        regions: Number of unseen regions.
        frame: Axes of all vectors: the capsule's, or the world's for actions in the world frame.
    """

    regions: Annotated[int, Range(min=0, max=64)] = 6
    frame: Literal["capsule", "world"] = "capsule"

    kind: ClassVar[str] = "landmarks"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, view: EnvView) -> Any:
        """Observation space: values from −1 to 1."""
        from gymnasium import spaces

        memory = view.memory
        count = 41 + 7 * self.regions + 6 * ("magnet/T" in memory) + ("navigate/goal" in memory)
        return spaces.Box(-1.0, 1.0, (count,), np.float32)

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each value; a magnitude d is encoded as d/(d + the unit in brackets)."""

        def vector(stem: str, unit: str) -> list[str]:
            return [f"{stem}_{axis} [{unit}]" for axis in "xyz"]

        names = ["course [1]", "time [1/episode_time]"]
        names += [f"seen_{level} [1]" for level in ("frustum", "visible", "resolved")]
        names += vector("to_centerline", "20 mm") + vector("tangent", "1") + vector("ahead", "1")
        attitude = "capsule_axis" if self.frame == "world" else "gravity"
        names += ["to_wall [20 mm]", *vector(attitude, "1"), *vector("velocity", "20 mm/s")]
        names += vector("angular_velocity", "1 rad/s") + vector("contact_force", "0.1 N")
        names += [f"ray_{k} [20 mm]" for k in range(len(RAYS))]
        for k in range(self.regions):
            facts = ("distance [20 mm]", "along [10 cm]", "area [0.01]", "is_free [1]")
            names += vector(f"region_{k}", "1") + [f"region_{k}_{fact}" for fact in facts]
        if "magnet/T" in view.memory:
            names += vector("to_magnet", "10 cm") + vector("magnet_moment", "1")
        return (*names, *(["to_goal [10 cm]"] if "navigate/goal" in view.memory else []))

    def observe(self, view: EnvView) -> Float[np.ndarray, "n k"]:
        """Return the features of all worlds."""
        s = view
        is_fixed = self.frame == "world"
        axes = np.eye(3)[None].repeat(s.num_worlds, 0) if is_fixed else s.T_world_capsule[:, :3, :3]
        to_regions, facts = self._regions(s)
        looks = _directions(to_regions)
        ways = np.concatenate([RAYS @ np.swapaxes(axes, 1, 2), looks], axis=1)
        distances = self._distances(s, ways)
        is_free = distances[:, len(RAYS) :] > np.linalg.norm(to_regions, axis=-1) - _HIDDEN
        facts = np.concatenate([facts, (is_free & (facts[..., 2] > 0.0))[..., None]], axis=-1)
        attitude = s.T_world_capsule[:, None, :3, 2] if is_fixed else [[[0.0, 0.0, -1.0]]]
        here = s.course.at(s.arc_length)
        vectors = [*self._guides(s, here), np.broadcast_to(attitude, (s.num_worlds, 1, 3))]
        vectors += [_soft_vectors(s.velocity_world, np.array([[_SPEED], [_SPIN]]))]
        vectors += [_soft_vectors(s.contact_force_world[:, None], _FORCE), looks]
        if "magnet/T" in s.memory:
            T_magnet = s.memory["magnet/T"]
            offset = T_magnet[:, None, :3, 3] - s.T_world_capsule[:, None, :3, 3]
            vectors += [_soft_vectors(offset, _FAR), T_magnet[:, None, :3, 2]]
        turned = np.concatenate(vectors, axis=1) @ axes
        return self._ordered(s, here, turned, distances[:, : len(RAYS)], facts)

    def _ordered(
        self,
        s: EnvView,
        here: CoursePoint,
        turned: np.ndarray,
        distances: np.ndarray,
        facts: np.ndarray,
    ) -> Float[np.ndarray, "n k"]:
        """Concatenate all features in the order of the class docstring."""
        n, last = s.num_worlds, 7 + self.regions
        regions = np.concatenate([turned[:, 7:last], facts], axis=2)
        parts = [
            (s.arc_length / s.course.length)[:, None],
            s.time[:, None] / s.episode_time,
            s.coverage.fraction,
            turned[:, :3].reshape(n, -1),
            _soft(here.radius[:, None], _DISTANCE),
            turned[:, 3:7].reshape(n, -1),
            _soft(distances, _DISTANCE),
            regions.reshape(n, -1),
            turned[:, last:].reshape(n, -1),
        ]
        if "navigate/goal" in s.memory:
            parts.append(_soft(s.memory["navigate/goal"] - s.arc_length, _FAR)[:, None])
        return np.concatenate(parts, axis=1).clip(-1.0, 1.0).astype(np.float32)

    def _guides(self, s: EnvView, here: CoursePoint) -> list[Float[np.ndarray, "n 1 3"]]:
        """Vectors to, along and ahead on the centerline, in the world frame."""
        position = s.T_world_capsule[:, :3, 3]
        ahead = s.course.at(s.arc_length + _AHEAD)
        vectors = [
            _soft_vectors(here.point - position, _DISTANCE),
            here.axes[:, 2],
            _directions(ahead.point - position),
        ]
        return [vector[:, None] for vector in vectors]

    def _regions(self, s: EnvView) -> tuple[Float[np.ndarray, "n m 3"], Float[np.ndarray, "n m 3"]]:
        """Vectors to unseen regions [m], world frame; distance, gut distance and area of each."""
        rows, columns = s.grid
        unseen = s.coverage.unseen_cells.reshape(-1, rows, columns, 1)
        sums = np.concatenate(
            [unseen * s.coverage.cell_center.reshape(-1, rows, columns, 3), unseen], axis=-1
        )
        firsts = [
            np.unique(np.arange(parts) * cells // parts)
            for parts, cells in zip(_PARTS, s.grid, strict=True)
        ]
        for axis, first in enumerate(firsts):
            sums = np.add.reduceat(sums, first, axis=axis + 1)
        middle = 0.5 * (firsts[0] + np.append(firsts[0][1:], rows)) / rows
        sums = sums.reshape(s.num_worlds, -1, 4)
        area = sums[..., 3]
        center = sums[..., :3] / np.maximum(area, 1e-12)[..., None]
        offset = np.where(area[..., None] > 0.0, center - s.T_world_capsule[:, None, :3, 3], 0.0)
        way = middle.repeat(len(firsts[1])) * s.course.length[:, None] - s.arc_length[:, None]
        distance = np.linalg.norm(offset, axis=-1)
        score = area / np.maximum(np.maximum(distance, np.abs(way)), _NEAREST)
        best = np.argsort(-score, axis=1, kind="stable")[:, : self.regions]
        facts = np.stack([_soft(distance, _DISTANCE), _soft(way, _FAR), _soft(area, _AREA)], -1)
        facts *= (area > 0.0)[..., None]
        lack = ((0, 0), (0, self.regions - best.shape[1]), (0, 0))
        chosen = (np.take_along_axis(x, best[..., None], axis=1) for x in (offset, facts))
        offset, facts = (np.pad(x, lack) for x in chosen)
        return offset, facts

    @staticmethod
    def _distances(s: EnvView, ways: Float[np.ndarray, "n k 3"]) -> Float[np.ndarray, "n k"]:
        """Distances to the wall [m] along directions in the world frame."""
        origins = transform_points(s.T_patient_world, s.T_world_capsule[:, :3, 3])
        is_none = np.einsum("nki,nki->nk", ways, ways) == 0.0
        ways = rotate_vectors(
            s.T_patient_world, np.where(is_none[..., None], [0.0, 0.0, 1.0], ways)
        )
        walls = [world.wall for world in s.batch.worlds]
        return _core.wall_distances(walls, origins, ways, _REACH).astype(float)


def _soft(value: np.ndarray, scale: float) -> np.ndarray:
    """Encode a value x as x / (|x| + scale)."""
    return value / (np.abs(value) + scale)


def _soft_vectors(vectors: Float[np.ndarray, "*n 3"], scale: Any) -> Float[np.ndarray, "*n 3"]:
    """Encode each vector v as v / (|v| + scale)."""
    return vectors / (np.linalg.norm(vectors, axis=-1, keepdims=True) + scale)


def _directions(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Unit vectors; 0 for zero vectors."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
