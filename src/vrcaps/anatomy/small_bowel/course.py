"""Small bowel course: C-shaped duodenum, then coils on the mesentery.

The jejunum and ileum hang from the root of the mesentery, which runs from the duodenojejunal
flexure to the ileocaecal valve. Their distance from it is limited by the depth of the mesentery.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.small_bowel.distance_routing import RoutingGrid, make_routing_grid, route_around
from vrcaps.anatomy.tube_mesh.tube import (
    ObstacleSpheres,
    TubeChain,
    min_clearance,
    relax_chain,
    sharpest_bend,
    smooth_course,
)
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM

if TYPE_CHECKING:
    from collections.abc import Iterator

    from jaxtyping import Float

    from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
    from vrcaps.anatomy.tube_mesh.tube import Course

_SPACING = 10 * MM
_GAP = 3 * MM
_MESENTERY = 16 * CM
"""Maximum distance from the root to the bowel (Gray's Anatomy: about 15 to 20 cm)."""
_NUM_STEPS = 240
_NUM_TRIES, _NUM_WIDTHS = 48, 24
"""Number of attempts, and of abdomen widths, which then repeat with the last clearance allowed."""
_NUM_REFINED = 80
_SPREAD = 1.25
_TOLERANCE = 0.015
_MIN_CLEARANCE = -0.3 * MM  # between outlines, a tenth outside the mean wall
_HOPELESS = -3.5 * MM
_NUM_FIXED = 3
_APPROACH = 3.5 * CM
_FILLING = 0.42
"""Maximum fraction of the free space that the bowel can fill."""
_BULGE = 8 * CM
_SHARPEST = 1.9

# Waypoints of the duodenum in a mean body from the pylorus to the duodenojejunal flexure,
# patient frame [cm]: x left, y posterior, z up, origin at the height of the navel.
_DUODENUM_CM = np.array(
    [
        [-5.6, 3.0, 11.6],
        [-6.3, 4.2, 8.8],
        [-6.4, 4.6, 5.4],
        [-5.2, 4.8, 2.8],
        [-2.6, 4.4, 1.9],
        [0.4, 4.0, 2.3],
        [2.6, 4.2, 4.2],
        [3.4, 3.6, 6.6],
        [4.2, 1.8, 6.4],
    ]
)
_LOW_CM, _HIGH_CM = np.array([-13.0, -10.0, -20.0]), np.array([13.0, 6.0, 9.0])
# Initial depths and heights between which the coils sweep from side to side.
_SWEEP_CM = 14.5
_BACK_CM, _NUM_LAYERS = 0.5, 3
_HEIGHTS_CM = (2.0, -15.0)
_NUM_CANDIDATES = 16


@dataclass(frozen=True)
class NeighboringOrgans:
    """Neighboring organs of a small bowel.

    Attributes:
        pylorus: Start of the small bowel [m], patient frame.
        pylorus_direction: Unit direction in which it leaves the stomach.
        beyond: Position that it passes after about 6 cm [m], clear of the other organs.
        valve: End of the small bowel [m]: the ileocaecal valve on the colon's wall.
        valve_direction: Unit direction in which it enters the colon.
        obstacles: Space occupied by the other organs.
        size: Size of the abdomen relative to the mean.
    """

    pylorus: Float[np.ndarray, " 3"]
    pylorus_direction: Float[np.ndarray, " 3"]
    beyond: Float[np.ndarray, " 3"]
    valve: Float[np.ndarray, " 3"]
    valve_direction: Float[np.ndarray, " 3"]
    obstacles: ObstacleSpheres
    size: float = 1.0


def generate_course(
    parameters: SmallBowelParameters,
    radius_of: Float[np.ndarray, " k"],
    around: NeighboringOrgans,
    rng: np.random.Generator,
) -> Course:
    """Generate a course from the pylorus to the ileocaecal valve with clearance for the bowel.

    Args:
        parameters: The patient's dimensions.
        radius_of: Outer radius at even fractions of the length [m].
        around: The neighboring organs.
        rng: Random generator of the coils.

    Raises:
        InputError: If no such course fits into the abdomen.
    """
    fractions = np.linspace(0.0, 1.0, len(radius_of))
    num = round(parameters.length / _SPACING) + 1
    radius = np.interp(np.linspace(0.0, 1.0, num), fractions, radius_of)
    for attempt in range(_NUM_TRIES):
        width = attempt % _NUM_WIDTHS
        least_allowed = _MIN_CLEARANCE * (1.0 + 0.25 * min(attempt, _NUM_WIDTHS - 1))
        grid = _abdomen(parameters.length, radius, around, width)
        chain, nodes = _start(parameters, radius, around, grid, width, rng)
        for course in _settling(parameters.length, chain, nodes, around.obstacles):
            fine = np.interp(course.arc_length / course.arc_length[-1], fractions, radius_of)
            clearance = min_clearance(course, fine, around.obstacles, _APPROACH)
            is_long = abs(parameters.length / course.arc_length[-1] - 1.0) < _TOLERANCE
            if is_long and clearance > least_allowed and sharpest_bend(course, fine) < _SHARPEST:
                return course
            if clearance < _HOPELESS:
                break
    raise InputError(
        f"Found no course for {parameters.length:.2f} m of small bowel in the abdomen. "
        "Allowed: a shorter one, smaller diameters, or another seed."
    )


def _settling(
    length: float, chain: TubeChain, nodes: Float[np.ndarray, "n 3"], obstacles: ObstacleSpheres
) -> Iterator[Course]:
    """Courses of a grown chain that converge to the requested length."""
    spacing = length / (len(nodes) - 1)
    nodes = relax_chain(chain, nodes, spacing, obstacles, num_steps=_NUM_STEPS, spread=_SPREAD)
    for _ in range(4):
        course = smooth_course(nodes)
        yield course
        spacing *= length / course.arc_length[-1]
        nodes = relax_chain(chain, nodes, spacing, obstacles, num_steps=_NUM_REFINED)


def _abdomen(
    length: float, radius: np.ndarray, around: NeighboringOrgans, attempt: int
) -> RoutingGrid:
    """Space for the bowel: a full abdomen bulges anteriorly and widens with each attempt."""
    low, high = (1.0 + 0.012 * attempt) * around.size * CM * np.array([_LOW_CM, _HIGH_CM])
    clearance = float(radius.mean())
    needed = length * np.pi * float(np.mean(radius**2)) / _FILLING
    bulge = 0.5 * CM * attempt
    while True:
        grid = make_routing_grid(low - [0.0, bulge, 0.0], high, around.obstacles, clearance)
        if grid.free_volume >= needed or bulge > _BULGE:
            return grid
        bulge += 1 * CM


def _start(
    parameters: SmallBowelParameters,
    radius: np.ndarray,
    around: NeighboringOrgans,
    grid: RoutingGrid,
    attempt: int,
    rng: np.random.Generator,
) -> tuple[TubeChain, Float[np.ndarray, "n 3"]]:
    """Constraints of the chain and its nodes before growth: duodenum, then waves to the valve."""
    num = len(radius)
    spacing = parameters.length / (num - 1)
    num_duodenum = round(parameters.duodenum_length / spacing)
    size = around.size
    exits = around.pylorus + np.outer(np.arange(_NUM_FIXED), around.pylorus_direction * spacing)
    waypoints = size * CM * (_DUODENUM_CM + rng.normal(0.0, 0.3, _DUODENUM_CM.shape))
    # Where the colon hangs anterior to the duodenojejunal flexure, a lower flexure passes below it.
    waypoints[4:] += min(attempt, 6) * rng.uniform(0.0, 1.0) * CM * np.array([0.0, 0.0, -0.8])
    waypoints[0] = around.beyond
    path = route_around(np.concatenate([exits[-1:], waypoints]), grid)
    duodenum = np.concatenate([exits, _along(path, num_duodenum - 2)[1:]])
    ending = around.valve - np.outer(np.arange(_NUM_FIXED)[::-1], around.valve_direction * spacing)
    num_free = num - num_duodenum - _NUM_FIXED
    root = np.linspace(duodenum[-1], ending[0], num_free + 2)[1:-1]
    sweeps = _sweeps(0.93 * spacing * num_free, around, grid, duodenum[-1], rng)
    path = route_around(np.concatenate([duodenum[-1:], sweeps, ending[:1]]), grid)
    nodes = _along(path, num_free + 2)[1:-1]
    nodes += 8 * MM * _swing(num_free, rng)
    chain = TubeChain(
        radius=radius,
        anchor=np.concatenate([duodenum, root, ending]),
        hold=np.concatenate([_ramp(num_duodenum), np.zeros(num_free + _NUM_FIXED)]),
        reach=np.concatenate(
            [np.full(num_duodenum, 5 * CM), np.full(num_free + _NUM_FIXED, size * _MESENTERY)]
        ),
        is_fixed=np.isin(np.arange(num), [*range(_NUM_FIXED), *range(num - _NUM_FIXED, num)]),
        low=grid.low,
        high=grid.high,
        gap=_GAP,
    )
    return chain, np.concatenate([duodenum, nodes, ending])


def _sweeps(
    length: float,
    around: NeighboringOrgans,
    grid: RoutingGrid,
    start: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "k 3"]:
    """Turning points of a bowel of about the given length that sweeps back and forth in layers [m].

    Of several random sweeps at the height of a layer, the one with the fewest crossings of other
    organs is used: relaxation can push the bowel off an organ, but not out of its loops.
    """
    num = max(8, round(length / (_SWEEP_CM * CM)))
    last_level = max((num - 1) // _NUM_LAYERS, 1)
    points = [start, around.size * CM * np.array([2.5, 1.5, 1.0])]
    depths = np.linspace(grid.low[1] / (around.size * CM) + 3.0, _BACK_CM, _NUM_LAYERS)
    for i in range(num):
        level, order = divmod(i, _NUM_LAYERS)
        depth = depths[order if level % 2 == 0 else -1 - order]
        height = np.interp(level / last_level, [0.0, 1.0], _HEIGHTS_CM)
        best, chosen = np.inf, np.zeros((2, 3))
        for _ in range(_NUM_CANDIDATES):
            middle = np.array([0.0, depth, height]) + rng.normal(0.0, [0.0, 1.2, 1.0])
            # In the lower right, leave space for the path back up to the valve.
            sides = np.array([rng.uniform(3.0, 9.5), rng.uniform(-6.5, -1.0)])
            if rng.uniform() < 0.5:
                sides = sides[::-1]
            ends = around.size * CM * (middle + np.outer(sides, [1.0, 0.0, 0.0]))
            cost = _crossing(np.array([points[-1], *ends]), around.obstacles)
            # Penalize a long path to the start of the sweep as a detour.
            cost += 0.5 * float(np.linalg.norm(ends[0] - points[-1])) ** 2 / (10 * CM)
            if cost < best:
                best, chosen = cost, ends
        points += list(chosen)
    return np.array(points[1:])


def _crossing(waypoints: Float[np.ndarray, "k 3"], obstacles: ObstacleSpheres) -> float:
    """Penetration of a polyline into obstacles: depth [m] summed over centimeters."""
    points = _along(waypoints, 30)
    distance, nearest = obstacles.tree.query(points, min(3, len(obstacles.radius)))
    depth = np.maximum(obstacles.radius[nearest] - distance, 0.0).reshape(len(points), -1)
    return float(depth.max(axis=1).sum())


def _swing(num: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Random smooth sideways waves of size about 1, one per 7 to 20 cm of bowel."""
    t = np.arange(num) * _SPACING
    waves = np.zeros((num, 3))
    for axis in range(3):
        for _ in range(4):
            wavelength = rng.uniform(7 * CM, 20 * CM)
            waves[:, axis] += 0.6 * np.sin(2 * np.pi * t / wavelength + rng.uniform(0, 2 * np.pi))
    return waves


def _ramp(num: int) -> Float[np.ndarray, " n"]:
    """Stiffness of the duodenum's attachment to the back of the abdomen, lower at both ends."""
    from_end = np.minimum(np.arange(num), np.arange(num)[::-1])
    return 0.15 * np.clip((from_end - 2.0) / 4.0, 0.0, 1.0)


def _along(waypoints: Float[np.ndarray, "k 3"], num: int) -> Float[np.ndarray, "n 3"]:
    """Evenly spaced points along a polyline, including both ends."""
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1)))
    even = np.linspace(0.0, chord[-1], num)
    return np.stack([np.interp(even, chord, waypoints[:, k]) for k in range(3)], axis=1)
