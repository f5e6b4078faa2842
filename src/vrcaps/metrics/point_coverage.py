"""Coverage of many worlds at once, by sample points on the wall that represent its area.

A point counts as visible if it is in the image and nothing lies between it and the camera. This
takes one ray per point for any image size, and none for points already seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import in_image, project_points
from vrcaps.core import rng
from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.geometry import octahedral_directions, triangle_areas
from vrcaps.core.units import MM
from vrcaps.metrics.coverage import CoverageCriteria, CoverageLevel, pixel_solid_angles

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8

    from vrcaps.camera.camera import Camera
    from vrcaps.organ.surface import OrganSurface

POINT_LEVELS: tuple[CoverageLevel, ...] = ("frustum", "visible", "resolved")
"""Levels at which points are marked; a point's flag has one bit for each, in this order."""

_POINTS_ON_LESION = 48
"""Points per lesion, since few of the other points would lie on a small one."""

_TABLE_SIZE = 512
"""Rows of a direction table: a cell is a third of a degree wide, a pixel of most capsules."""


_RING = 5.0 * MM
"""Length of the rings of wall by which points are ordered."""


def require_point_level(level: str, what: str) -> None:
    """Check that points are marked at a level of coverage.

    Args:
        level: The level.
        what: Owner of the level, for messages.

    Raises:
        UnknownNameError: If points are not marked at this level.
    """
    if level not in POINT_LEVELS:
        raise UnknownNameError(f"level of coverage for a {what}", level, POINT_LEVELS)


@dataclass(frozen=True)
class WallPoints:
    """Points on an organ's wall, drawn evenly over its area or over its vertices.

    Attributes:
        face: Triangle of each point.
        weights: Barycentric weights of the triangle's first two corners.
        fractions: Weight of each point as a fraction of the whole, at `frustum` and at the other
            levels.
        cell: Cell of the organ's map that contains each point.
        lesions: IDs of the wall's lesions, in increasing order. The last points lie on them, the
            same number on each, lesion by lesion; their weight is 0.
        core: The same for the core.
    """

    face: Int[np.ndarray, " k"]
    weights: Float[np.ndarray, "k 2"]
    fractions: Float[np.ndarray, "k 2"]
    cell: Int[np.ndarray, " k"]
    lesions: Int[np.ndarray, " m"]
    core: _core.WallPoints

    def __len__(self) -> int:
        return len(self.face)

    @property
    def first_of_lesions(self) -> int:
        """Index of the first point that lies on a lesion."""
        return len(self.face) - _POINTS_ON_LESION * len(self.lesions)


def wall_points(
    organ: OrganSurface, count: int | None = 4096, grid: tuple[int, int] = (32, 16), seed: int = 0
) -> WallPoints:
    """Points of a wall with the cells of its map in gut coordinates.

    The level `frustum` counts vertices, the others area. A quarter of `count` are therefore
    vertices, and the rest are drawn one in each of equally many parts of equal area.

    Args:
        organ: The wall.
        count: Number of points; None takes every vertex and the center of every triangle.
        grid: Cells of the map along the centerline and around it.
        seed: Seed of the positions of the points.

    Raises:
        InputError: If there are fewer than 64 points.
    """
    area = triangle_areas(organ.vertices[organ.faces])
    draw = rng.stream(seed, "metrics/wall_points")
    if count is None:
        vertices, faces = np.arange(len(organ.vertices)), np.arange(len(organ.faces))
        weights = np.full((len(faces), 2), 1.0 / 3.0)
        by_area = area / area.sum()
    else:
        require(count >= 64, "Number of points", count, "64 or more")
        num_vertices = min(count // 4, len(organ.vertices))
        order = _gut_order(organ.arc_length, organ.theta)
        part = (np.arange(num_vertices) + draw.random(num_vertices)) / num_vertices
        vertices = order[(part * len(order)).astype(int)]
        faces, weights = _even_points(draw, organ, area, count - num_vertices)
        by_area = np.full(len(faces), 1.0 / len(faces))
    corner_face, corner_weights = _corners(organ, vertices)
    lesions = np.unique(organ.instance[organ.instance > 0])
    on_lesions = [_lesion_points(draw, organ, area, number) for number in lesions]
    face = np.concatenate([corner_face, faces, *(face for face, _ in on_lesions)])
    fractions = np.zeros((len(face), 2))
    fractions[: len(vertices), 0] = 1.0 / len(vertices)
    fractions[len(vertices) : len(vertices) + len(faces), 1] = by_area
    weights = np.concatenate([corner_weights, weights, *(weights for _, weights in on_lesions)])
    cell = _cells(organ, face, weights, grid)
    core = _core.WallPoints(
        organ.faces[face].astype(np.uint32),
        weights.astype(np.float32),
        fractions,
        cell.astype(np.uint32),
    )
    return WallPoints(face, weights, fractions, cell, lesions, core)


def _lesion_points(
    draw: np.random.Generator, organ: OrganSurface, area: np.ndarray, instance: int
) -> tuple[np.ndarray, np.ndarray]:
    """Faces and weights of points distributed evenly over a lesion."""
    corners = (organ.instance[organ.faces] == instance).sum(axis=1)
    # A lesion of a few vertices may contain no whole face.
    mine = corners >= min(2, corners.max())
    return _even_points(draw, organ, area * mine, _POINTS_ON_LESION)


def _even_points(
    draw: np.random.Generator, organ: OrganSurface, area: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Faces and weights of points, one in each of `count` equal parts of the area in gut order."""
    first = organ.faces[:, 0]
    order = _gut_order(organ.arc_length[first], organ.theta[first])
    passed = np.cumsum(area[order])
    at = (np.arange(count) + draw.random(count)) / count * passed[-1]
    faces = order[np.searchsorted(passed, at).clip(0, len(order) - 1)]
    root, share = np.sqrt(draw.random(count)), draw.random(count)
    return faces, np.stack([1.0 - root, root * (1.0 - share)], axis=-1)


def _gut_order(arc_length: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Order in which successive entries are close together: ring by ring."""
    ring = np.floor(arc_length / _RING)
    return np.lexsort((np.where(ring % 2 == 0, theta, -theta), ring))


def _corners(organ: OrganSurface, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A face of each vertex, and the weights of a point at that corner."""
    flat = organ.faces.ravel()
    first = np.zeros(len(organ.vertices), np.int64)
    first[flat[::-1]] = np.arange(len(flat))[::-1]
    face, corner = np.divmod(first[vertices], 3)
    return face, np.eye(3)[corner][:, :2]


def _cells(
    organ: OrganSurface, face: np.ndarray, weights: np.ndarray, grid: tuple[int, int]
) -> np.ndarray:
    """Index of the cell of each point, in row-major order along the centerline."""
    weights = np.concatenate([weights, 1.0 - weights.sum(axis=1, keepdims=True)], axis=1)
    corners = organ.faces[face]
    arc_length = (organ.arc_length[corners] * weights).sum(axis=1) / organ.centerline.length
    theta = organ.theta[corners]
    turns = theta[:, :1] + (theta - theta[:, :1] + np.pi) % (2.0 * np.pi) - np.pi
    angle = ((turns * weights).sum(axis=1) / (2.0 * np.pi) + 0.5) % 1.0
    rows, columns = grid
    row = (arc_length * rows).astype(int).clip(0, rows - 1)
    return row * columns + (angle * columns).astype(int).clip(0, columns - 1)


@lru_cache(maxsize=32)
def direction_table(camera: Camera) -> _core.DirectionTable:
    """Pixels per steradian of a camera by direction; 0 where it has no image."""
    directions = octahedral_directions(_TABLE_SIZE)
    with np.errstate(all="ignore"):
        pixels = project_points(camera, directions)
    inside = in_image(camera, pixels)
    column, row = (
        np.rint(np.where(inside, pixels[..., k], 0.0)).astype(int).clip(0, most - 1)
        for k, most in enumerate((camera.width, camera.height))
    )
    density = np.nan_to_num(1.0 / pixel_solid_angles(camera), posinf=0.0)[row, column]
    # A pixel at the edge of the lens has no solid angle, but is part of the image.
    least = density[density > 0.0].min(initial=1.0)
    return _core.DirectionTable(np.where(inside, np.maximum(density, least), 0.0).astype("f4"))


def mark_points(
    walls: Sequence[_core.Wall],
    points: Sequence[WallPoints],
    camera: Camera,
    Ts_wall_camera: Float[np.ndarray, "n 4 4"],
    flags: Sequence[UInt8[np.ndarray, " k"]],
    cells: Float[np.ndarray, "n c"],
    criteria: CoverageCriteria,
) -> Float[np.ndarray, "n 3"]:
    """Mark the points of each wall that a camera sees, for many walls.

    Args:
        walls: Wall of each view.
        points: Points of each wall.
        camera: Camera of all views.
        Ts_wall_camera: Poses of the camera in the frames of the walls.
        flags: For each point, a bit for each of `POINT_LEVELS`; marked in place.
        cells: Fraction of the whole that is visible in each cell; added to in place.
        criteria: Criteria of near enough and resolved points.

    Returns:
        Fraction of the whole that is seen for the first time at each of `POINT_LEVELS`.
    """
    return _core.mark_points(
        walls,
        [p.core for p in points],
        direction_table(camera),
        np.ascontiguousarray(Ts_wall_camera, float),
        list(flags),
        cells,
        max_depth=criteria.max_depth,
        min_density=criteria.min_pixel_density,
        min_cosine=math.cos(criteria.max_incidence),
    )
