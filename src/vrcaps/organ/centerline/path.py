"""Path through the middle of a lumen: its two ends and the cheapest route between them."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.organ.centerline.ends import any_end, far_end, nearest_voxel
from vrcaps.organ.centerline.lumen import LumenGrid

if TYPE_CHECKING:
    from jaxtyping import Float, Int

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
    from skimage.graph import MCP_Geometric

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
        where = grid.points(np.stack([first, last])).round(5).tolist()
        raise InputError(
            f"The centerline would go from {where[0]} to {where[1]} m, which is one place. "
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
        where = grid.points(ids[~grid.inside[tuple(ids.T)]][:1])[0]
        _log.warning("centerline crosses a closed place of %.2g m at %s m", gap * grid.voxel, where)
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
