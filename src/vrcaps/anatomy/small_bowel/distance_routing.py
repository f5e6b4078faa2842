"""Distance-field routing: cheapest paths around other organs on a grid of the abdomen.

Relaxation can push the bowel off an organ, but not out of its loops. A course that is routed
first only needs the former.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.tube_mesh.tube import ObstacleSpheres

_STEP = 10 * MM
_DETOUR = 30.0
"""Cost of a path through an organ relative to the same length of free path, less 1."""


@dataclass(frozen=True)
class RoutingGrid:
    """Grid of points in the abdomen with the costs between neighbors.

    Attributes:
        points: Grid points [m].
        tree: Tree for nearest-point queries.
        graph: Cost of the edge between neighbors [m], higher where the clearance is too small.
        obstacles: The other organs.
        clearance: Distance to keep from obstacles [m].
        low: Minimum coordinates of the box [m].
        high: Maximum coordinates of the box [m].
    """

    points: Float[np.ndarray, "n 3"]
    tree: scipy.spatial.KDTree
    graph: scipy.sparse.csr_matrix
    obstacles: ObstacleSpheres
    clearance: float
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]

    @property
    def free_volume(self) -> float:
        """Volume of the box outside all obstacles [m³]."""
        fraction = float(np.mean(distance_to_obstacles(self.points, self.obstacles) > 0.0))
        return fraction * float(np.prod(self.high - self.low))


def make_routing_grid(
    low: Float[np.ndarray, " 3"],
    high: Float[np.ndarray, " 3"],
    obstacles: ObstacleSpheres,
    clearance: float,
) -> RoutingGrid:
    """Create a grid over a box with edges weighted by the distance field of the obstacles.

    Args:
        low: Minimum coordinates of the box [m].
        high: Maximum coordinates of the box [m].
        obstacles: The other organs.
        clearance: Radius of the routed tube [m].
    """
    axes = [np.arange(a, b + _STEP, _STEP) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    shape, points = grid.shape[:3], grid.reshape(-1, 3)
    distance = distance_to_obstacles(points, obstacles)
    cost = 1.0 + _DETOUR * np.clip(1.0 - distance / clearance, 0.0, 2.0)
    start, end = _grid_edges(shape)
    length = np.linalg.norm(points[end] - points[start], axis=1)
    weight = 0.5 * length * (cost[start] + cost[end])
    graph = scipy.sparse.csr_matrix((weight, (start, end)), shape=(len(points), len(points)))
    return RoutingGrid(points, scipy.spatial.KDTree(points), graph, obstacles, clearance, low, high)


def _grid_edges(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Indices of both ends of every edge of the grid, including diagonals."""
    index = np.arange(int(np.prod(shape))).reshape(shape)
    starts, ends = [], []
    for offset in itertools.product((-1, 0, 1), repeat=3):
        if offset > (0, 0, 0):
            pairs = list(zip(offset, shape, strict=True))
            here = tuple(slice(max(0, -d), size - max(0, d)) for d, size in pairs)
            there = tuple(slice(max(0, d), size - max(0, -d)) for d, size in pairs)
            starts.append(index[here].ravel())
            ends.append(index[there].ravel())
    return np.concatenate(starts), np.concatenate(ends)


def route_around(
    waypoints: Float[np.ndarray, "k 3"], grid: RoutingGrid
) -> Float[np.ndarray, "m 3"]:
    """Polyline whose legs through obstacles are replaced by detours around them.

    The first and the last waypoint are kept; the others move to points of sufficient clearance.
    """
    waypoints = waypoints.copy()
    is_crowded = distance_to_obstacles(waypoints, grid.obstacles) < grid.clearance
    is_crowded[[0, -1]] = False
    waypoints[is_crowded] = _nearest_free(waypoints[is_crowded], grid)
    legs = [waypoints[:1]]
    for start, end in itertools.pairwise(waypoints):
        leg = np.linspace(start, end, 2 + int(np.linalg.norm(end - start) / (0.5 * _STEP)))[1:]
        if distance_to_obstacles(leg, grid.obstacles).min() < 0.5 * grid.clearance:
            leg = np.concatenate([_cheapest_path(start, end, grid), end[None]])
        legs.append(leg)
    return np.concatenate(legs)


def _nearest_free(points: Float[np.ndarray, "k 3"], grid: RoutingGrid) -> Float[np.ndarray, "k 3"]:
    """Nearest grid point with sufficient clearance, for each point."""
    free = grid.points[distance_to_obstacles(grid.points, grid.obstacles) >= grid.clearance]
    if not len(free) or not len(points):
        return points
    return free[scipy.spatial.KDTree(free).query(points)[1]]


def _cheapest_path(
    start: np.ndarray, end: np.ndarray, grid: RoutingGrid
) -> Float[np.ndarray, "k 3"]:
    """Cheapest path over the grid between two points, without its end points."""
    first, last = grid.tree.query([start, end])[1]
    _, before = scipy.sparse.csgraph.dijkstra(
        grid.graph, directed=False, indices=first, return_predecessors=True
    )
    path = [last]
    while path[-1] != first:
        path.append(before[path[-1]])
    return grid.points[path[-2:0:-1]]


def distance_to_obstacles(
    points: Float[np.ndarray, "n 3"], obstacles: ObstacleSpheres
) -> Float[np.ndarray, " n"]:
    """Distance to the surface of the nearest obstacle [m], negative inside."""
    num = min(8, len(obstacles.radius))
    distance, nearest = obstacles.tree.query(points, num)
    return (distance - obstacles.radius[nearest]).reshape(len(points), num).min(axis=1)
