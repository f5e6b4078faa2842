"""Ways around other organs: relaxation can push the bowel off an organ, not out of its loops."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.tube_mesh.tube_packing import Balls

_STEP = 10 * MM
_DETOUR = 30.0
"""Length of free way that is worth as much as the same length through an organ."""


@dataclass(frozen=True)
class Terrain:
    """A grid of places in the abdomen and what it costs to pass from one to the next.

    Attributes:
        places: Of the grid [m].
        tree: For the nearest places.
        graph: Cost of the way between neighbours [m], more where there is no room.
        obstacles: What is in the way.
        room: Distance to keep from obstacles [m].
        low: Lowest coordinates of the box [m].
        high: Highest coordinates of the box [m].
    """

    places: Float[np.ndarray, "n 3"]
    tree: KDTree
    graph: csr_matrix
    obstacles: Balls
    room: float
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]

    @property
    def free_volume(self) -> float:
        """Volume of the box outside all obstacles [m³]."""
        share = float(np.mean(clearance(self.places, self.obstacles) > 0.0))
        return share * float(np.prod(self.high - self.low))


def survey(
    low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"], obstacles: Balls, room: float
) -> Terrain:
    """The terrain of a box [m] in which a tube of radius `room` [m] looks for its way."""
    axes = [np.arange(a, b + _STEP, _STEP) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    shape, places = grid.shape[:3], grid.reshape(-1, 3)
    cost = 1.0 + _DETOUR * np.clip(1.0 - clearance(places, obstacles) / room, 0.0, 2.0)
    number = np.arange(len(places)).reshape(shape)
    starts, ends = [], []
    for offset in itertools.product((-1, 0, 1), repeat=3):
        if offset > (0, 0, 0):
            here = [
                slice(max(0, -d), size - max(0, d)) for d, size in zip(offset, shape, strict=True)
            ]
            there = [
                slice(max(0, d), size - max(0, -d)) for d, size in zip(offset, shape, strict=True)
            ]
            starts.append(number[tuple(here)].ravel())
            ends.append(number[tuple(there)].ravel())
    start, end = np.concatenate(starts), np.concatenate(ends)
    length = np.linalg.norm(places[end] - places[start], axis=1)
    weight = 0.5 * length * (cost[start] + cost[end])
    graph = csr_matrix((weight, (start, end)), shape=(len(places), len(places)))
    return Terrain(places, KDTree(places), graph, obstacles, room, low, high)


def lead_around(waypoints: Float[np.ndarray, "k 3"], terrain: Terrain) -> Float[np.ndarray, "m 3"]:
    """A polyline whose legs through obstacles are replaced by ways around them.

    The first and the last waypoint stay; those in between are moved where they have room.
    """
    waypoints = waypoints.copy()
    crowded = clearance(waypoints, terrain.obstacles) < terrain.room
    crowded[[0, -1]] = False
    waypoints[crowded] = _nearest_free(waypoints[crowded], terrain)
    legs = [waypoints[:1]]
    for start, end in itertools.pairwise(waypoints):
        leg = np.linspace(start, end, 2 + int(np.linalg.norm(end - start) / (0.5 * _STEP)))[1:]
        if clearance(leg, terrain.obstacles).min() < 0.5 * terrain.room:
            leg = np.concatenate([_way(start, end, terrain), end[None]])
        legs.append(leg)
    return np.concatenate(legs)


def _nearest_free(points: Float[np.ndarray, "k 3"], terrain: Terrain) -> Float[np.ndarray, "k 3"]:
    """The nearest place of the grid with room, for each point."""
    free = terrain.places[clearance(terrain.places, terrain.obstacles) >= terrain.room]
    if not len(free) or not len(points):
        return points
    return free[KDTree(free).query(points)[1]]


def _way(start: np.ndarray, end: np.ndarray, terrain: Terrain) -> Float[np.ndarray, "k 3"]:
    """The cheapest way over the grid between two points, without its first and last place."""
    first, last = terrain.tree.query([start, end])[1]
    _, before = dijkstra(terrain.graph, directed=False, indices=first, return_predecessors=True)
    path = [last]
    while path[-1] != first:
        path.append(before[path[-1]])
    return terrain.places[path[-2:0:-1]]


def clearance(points: Float[np.ndarray, "n 3"], obstacles: Balls) -> Float[np.ndarray, " n"]:
    """Distance to the surface of the nearest obstacles [m], negative inside."""
    num = min(8, len(obstacles.radius))
    distance, nearest = obstacles.tree.query(points, num)
    return (distance - obstacles.radius[nearest]).reshape(len(points), num).min(axis=1)
