"""Path through the middle of a lumen: its two ends, the cheapest route, smoothing and centering."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import wall_distance
from vrcaps.organ.lumen_grid import LumenGrid

if TYPE_CHECKING:
    from jaxtyping import Float, Int


_WALL_COST = 2.0  # of a step next to the wall, in steps through free lumen
_SLENDER = 3.0  # maximum volume of an end pouch, in cubes of its depth
_MIN_DEPTH = 4.0  # minimum depth of an end pouch [voxels]
_CENTRAL = 4.0  # exponent of the wall distance that weights a pouch's voxels


def far_end(
    grid: LumenGrid, seed: Float[np.ndarray, " 3"], outside_cost: float
) -> Float[np.ndarray, " 3"] | None:
    """Center [voxels] of the pouch farthest from a seed; None if over 1 % is unreachable.

    The farthest voxel of a wide pouch depends on small details of its wall; the mean of all voxels
    less than a depth w before it does not. w is the minimum depth at which their volume is at most
    3 w³ (at the end of a tube, its radius), so that a narrow end is its own pouch. Voxels are
    weighted by the fourth power of their distance from the wall.

    Args:
        grid: The lumen.
        seed: Start of the search [voxels].
        outside_cost: Cost of a step outside the lumen, in steps inside; negative forbids it.
    """
    depth = _depth(grid, seed, outside_cost)
    return None if depth is None else _middle(grid, depth)


def any_end(grid: LumenGrid, outside_cost: float) -> Float[np.ndarray, " 3"] | None:
    """Center [voxels] of the pouch farthest from the widest point; see `far_end`.

    In a round lumen the farthest voxels lie all around the widest point. Their center is then
    not an end: it is nearer to the widest point than to them. A single farthest voxel is on one
    side, so the search for the end starts there.
    """
    widest = np.array(np.unravel_index(np.argmax(grid.clearance), grid.inside.shape))
    depth = _depth(grid, widest, outside_cost)
    if depth is None:
        return None
    end = _middle(grid, depth)
    if not 0.5 * depth[tuple(widest)] < depth[nearest_voxel(end)] < np.inf:
        return end
    farthest = np.array(np.unravel_index(np.argmin(depth), depth.shape))
    return far_end(grid, farthest, outside_cost)


def _middle(grid: LumenGrid, depth: Float[np.ndarray, "x y z"]) -> Float[np.ndarray, " 3"]:
    """Center [voxels] of the farthest pouch; its most central voxel if that is near a wall."""
    pouch = _pouch(depth, _pouch_depth(depth))
    weight = grid.clearance[tuple(pouch.T)] ** _CENTRAL
    middle = weight @ pouch / weight.sum()
    deepest = pouch[np.argmax(weight)]
    is_central = grid.clearance[nearest_voxel(middle)] > 0.5 * grid.clearance[tuple(deepest)]
    return middle if is_central else deepest.astype(float)


def _depth(
    grid: LumenGrid, seed: Float[np.ndarray, " 3"], outside_cost: float
) -> Float[np.ndarray, "x y z"] | None:
    """Distance from the seed relative to the farthest voxel, in steps; see `far_end`.

    Infinite outside the lumen and next to its wall; None if over 1 % is unreachable.
    """
    MCP_Geometric = import_extra("skimage.graph", "organs", package="scikit-image").MCP_Geometric

    free = grid.clearance >= grid.voxel
    cost = np.where(grid.inside, np.where(free, 1.0, _WALL_COST), outside_cost)
    # Steps across faces only: a diagonal step may slip through a thin wall.
    walked, _ = MCP_Geometric(cost, fully_connected=False).find_costs([nearest_voxel(seed)])
    reached = np.isfinite(walked) & grid.inside
    if np.count_nonzero(reached) < 0.99 * np.count_nonzero(grid.inside):
        return None
    free &= reached
    counted = free if free.any() else reached
    return np.where(counted, walked[counted].max() - walked, np.inf)


def nearest_voxel(point: Float[np.ndarray, " 3"]) -> tuple[int, int, int]:
    """Index of the voxel at a position [voxels]."""
    x, y, z = np.rint(point).astype(int).tolist()
    return x, y, z


def _pouch_depth(depth: Float[np.ndarray, "x y z"]) -> float:
    """Minimum depth [voxels] whose volume is at most `_SLENDER` cubes of it."""
    depth = np.sort(depth[np.isfinite(depth)])
    slender = np.arange(1, len(depth) + 1) <= _SLENDER * depth**3
    slender &= depth >= _MIN_DEPTH
    return float(depth[np.argmax(slender)]) if slender.any() else float(depth[-1])


def _pouch(depth: Float[np.ndarray, "x y z"], limit: float) -> Int[np.ndarray, "n 3"]:
    """Voxels up to a depth that are connected to the farthest, within twice this depth."""
    wide = np.empty(depth.shape, np.int32)
    scipy.ndimage.label(depth <= 2.0 * limit, output=wide)
    farthest = np.unravel_index(np.argmin(depth), depth.shape)
    return np.argwhere((wide == wide[farthest]) & (depth <= limit))


_CENTERING = 3.0  # a step costs clearance^-3, which prevents short cuts near the wall
_MIN_SPAN = 3.0  # minimum distance between the two ends [voxels]
_GAP_COST = 1e4  # of a step outside the lumen, in steps next to the wall

_log = logging.getLogger(__name__)


def find_path(
    grid: LumenGrid,
    start: Float[np.ndarray, " 3"] | None,
    end: Float[np.ndarray, " 3"] | None,
    *,
    cross_gaps: bool = False,
) -> Float[np.ndarray, "k 3"] | None:
    """Find voxel centers along the middle of the lumen, from one end to the other [m].

    The cost of a step falls with the cube of its distance from the wall. Missing ends are found
    by `far_end`.

    Args:
        grid: The lumen.
        start: Start of the path [m], or None.
        end: End of the path [m], or None.
        cross_gaps: Whether the path may cross voxels that the grid marks as outside.

    Returns:
        The path, or None if parts of the lumen are disconnected.

    Raises:
        InputError: If an end lies outside the lumen, or both coincide.
    """
    MCP_Geometric = import_extra("skimage.graph", "organs", package="scikit-image").MCP_Geometric

    clear = np.maximum(grid.clearance / grid.voxel, 0.25)
    outside = _GAP_COST if cross_gaps else -1.0
    first = _snap(grid, start, "start") if start is not None else None
    last = _snap(grid, end, "end") if end is not None else None
    if first is None:
        first = any_end(grid, outside) if last is None else far_end(grid, last, outside)
    if last is None and first is not None:
        last = far_end(grid, first, outside)
    if first is None or last is None:
        return None
    if np.linalg.norm(last - first) < _MIN_SPAN:
        ends = grid.points(np.stack([first, last])).round(5).tolist()
        raise InputError(
            f"The centerline starts at {ends[0]} and ends at {ends[1]} m, the same position. "
            "Give its start and end, at opposite sides of the lumen."
        )
    cost = np.where(grid.inside, clear**-_CENTERING, outside * 0.25**-_CENTERING)
    costs = MCP_Geometric(cost)
    total, _ = costs.find_costs([nearest_voxel(first)], [nearest_voxel(last)])
    if not np.isfinite(total[nearest_voxel(last)]):
        return None
    ids = np.array(costs.traceback(nearest_voxel(last)))
    gap = np.count_nonzero(~grid.inside[tuple(ids.T)])
    if gap:
        crossing = grid.points(ids[~grid.inside[tuple(ids.T)]][:1])[0]
        _log.warning("centerline crosses a gap of %.2g m at %s m", gap * grid.voxel, crossing)
    return grid.points(np.vstack([first, ids[1:-1], last]))


def _snap(grid: LumenGrid, point: Float[np.ndarray, " 3"], name: str) -> Int[np.ndarray, " 3"]:
    """Voxel of the lumen nearest to a point.

    Raises:
        InputError: If the point is not finite or lies outside the lumen.
    """
    point = np.asarray(point, float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InputError(f"The centerline's {name} is {point.tolist()}. Give x, y, z in meters.")
    ids = np.argwhere(grid.inside)
    away = np.linalg.norm(grid.points(ids) - point, axis=1)
    nearest = int(np.argmin(away))
    if away[nearest] > 2.0 * grid.voxel:
        raise InputError(
            f"The centerline's {name} {point.tolist()} m lies {away[nearest]:.3g} m outside the "
            f"lumen. Give a point inside; the nearest is {grid.points(ids[nearest]).tolist()} m."
        )
    return ids[nearest]


_SMOOTHING = 0.5  # wavelength below which wiggles are damped, in local radii
_KEEP = 0.6  # fraction of its clearance that a point keeps when smoothed
_ROUNDS = 30
_CENTERING_ROUNDS = 12
_END_WINDOW = 2  # voxels beyond its clearance in which an end is compared
_MIN_CENTRALITY = 0.9  # fraction of the maximum clearance there at which an end is central


def smooth_path(
    grid: LumenGrid, path: Float[np.ndarray, "k 3"], free: tuple[bool, bool] = (True, True)
) -> Float[np.ndarray, "n 3"]:
    """Smooth curve along the middle of the lumen, from wall to wall [m].

    Free ends first approach the middle from the side; this part is removed. The curve is
    alternately moved towards maximum clearance and smoothed.

    Args:
        grid: The lumen.
        path: Voxel centers along it [m].
        free: Whether the first and the last end may be moved.

    Raises:
        InputError: If nothing is left of the path.
    """
    path = resample(path, grid.voxel)
    path = _trim(grid, path) if free[0] else path
    path = _trim(grid, path[::-1])[::-1] if free[1] else path
    for _ in range(_CENTERING_ROUNDS):
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        if not length > grid.voxel:
            raise InputError(
                f"The centerline shrinks to {length / MM:.2g} mm: the lumen is hardly longer than "
                "it is wide. Give its start and end, at opposite sides of the lumen."
            )
        path = resample(_smooth(grid, _center(grid, path)), grid.voxel)
    return path


def resample(points: Float[np.ndarray, "k 3"], step: float) -> Float[np.ndarray, "n 3"]:
    """Evenly spaced points, about `step` apart, along a polyline including its ends."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0.0, arc[-1], max(int(np.ceil(arc[-1] / step)), 4) + 1)
    return np.stack([np.interp(at, arc, points[:, axis]) for axis in range(3)], axis=1)


def _trim(grid: LumenGrid, path: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "n 3"]:
    """Path from the first point whose clearance is nearly the maximum within reach."""
    clearance = grid.clearance_at(path)
    for i in range(len(path) // 3):
        ahead = clearance[i : i + _END_WINDOW + int(clearance[i] / grid.voxel)]
        if clearance[i] >= max(grid.voxel, _MIN_CENTRALITY * ahead.max()):
            return path[i:]
    return path[len(path) // 3 :]


def to_wall(
    grid: LumenGrid,
    path: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "k 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, "l 3"]:
    """Extend the path straight on from its last point until 1.5 voxels before the wall.

    The end is measured exactly, as voxels would round it.

    Args:
        grid: The lumen.
        path: Points along the middle of the lumen [m], a voxel apart.
        vertices: Vertices of the wall without open ends [m].
        faces: Faces of the wall.
    """
    voxel, reach = grid.voxel, grid.clearance_at(path[-1:])[0]
    back = min(len(path) - 1, max(2, int(reach / voxel)))
    direction = path[-1] - path[-1 - back]
    direction /= np.linalg.norm(direction)
    margin = min(1.5 * voxel, 0.5 * reach)
    away = voxel * np.arange(1.0, max(grid.inside.shape))
    near = grid.clearance_at(path[-1] + away[:, None] * direction) < margin
    about = away[np.argmax(near)]
    fine = np.arange(max(about - 2.0 * voxel, 0.0), about + 2.0 * voxel, 0.1 * voxel)
    distances = wall_distance(path[-1] + fine[:, None] * direction, vertices, faces)
    stop = fine[np.argmax(distances < margin)] if (distances < margin).any() else about
    line = np.append(away[away < stop - 0.5 * voxel], stop)[:, None]
    return np.concatenate([path, path[-1] + line * direction])


def _center(grid: LumenGrid, path: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Move each point across the curve towards larger clearance, by at most a voxel."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    half = np.maximum(0.2 * grid.clearance_at(path), grid.voxel)[:, None]
    slope = np.stack(
        [
            grid.clearance_at(path + half * axis) - grid.clearance_at(path - half * axis)
            for axis in np.eye(3)
        ],
        axis=1,
    ) / (2.0 * half)
    slope -= (slope * tangent).sum(axis=1, keepdims=True) * tangent
    return path + grid.voxel * slope


def _smooth(grid: LumenGrid, path: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Curve x that minimizes Σ w |x − path|² + Σ |x″|², w = (step / smoothing length)⁴.

    Where x would be too close to the wall, w is raised until it is not.
    """
    clearance = grid.clearance_at(path)
    step = np.linalg.norm(path[1] - path[0])
    weight = (step / (_SMOOTHING * np.maximum(clearance, grid.voxel))) ** 4
    smooth = path
    for _ in range(_ROUNDS):
        smooth = scipy.linalg.solveh_banded(_bending(weight), weight[:, None] * path)
        tight = grid.clearance_at(smooth) < _KEEP * clearance
        if not tight.any():
            break
        weight = np.where(tight, 4.0 * weight, weight)
    return smooth


def _bending(weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3 n"]:
    """Upper bands of diag(weight) + DᵀD, with D the second difference."""
    n = len(weight)
    bands = np.zeros((3, n))
    for offset, row in ((0, (1.0, 4.0, 1.0)), (1, (-2.0, -2.0)), (2, (1.0,))):
        for shift, value in enumerate(row):
            bands[2 - offset, offset + shift : n - 2 + offset + shift] += value
    bands[2] += weight
    return bands
