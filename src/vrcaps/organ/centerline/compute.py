"""Centerline of a surface: voxelization, path, smoothing and detection of the oral end."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.centerline.curve import centerline_from_points, transport_frames
from vrcaps.organ.centerline.handles import num_handles, without_short_cuts
from vrcaps.organ.centerline.lumen import (
    MAX_VOXELS,
    LumenGrid,
    close_ends,
    mean_radius,
    num_pieces,
    voxelize,
)
from vrcaps.organ.centerline.path import find_path
from vrcaps.organ.centerline.smooth import smooth_path, to_wall
from vrcaps.organ.surface import Centerline

if TYPE_CHECKING:
    from jaxtyping import Float

_VOXELS_PER_RADIUS = 10.0
_MAX_INSIDE = 8_000_000  # voxels of a lumen, searched within seconds
_REFINEMENTS = 3
_END_FRACTION = 1 / 3  # of the length, to measure the width of an end
_REACH = 3.0  # radii from the curve within which the lumen is covered
_MAX_LEFT_OUT = 0.1  # of the lumen may lie beyond that reach
_NUM_PROBES = 20_000  # points in the lumen to estimate that fraction

_log = logging.getLogger(__name__)


def compute_centerline(
    mesh: Mesh,
    *,
    voxel: float | None = None,
    start: Float[np.ndarray, " 3"] | None = None,
    end: Float[np.ndarray, " 3"] | None = None,
    reverse: bool = False,
) -> Centerline:
    """Compute the smooth centerline of a lumen from end to end.

    The centerline is a centered and smoothed minimum-cost path through the lumen's distance field.
    Where the wall has handles (touching loops that are open to each other) it follows the course of
    the lumen, see `without_short_cuts`. A curve that omits over a tenth of the lumen causes a
    warning. The two ends are the points farthest apart inside the lumen. A mesh does not state
    which is the oral one; it is assumed to be the end with the wider third, which holds for a
    colon (caecum to rectum) and a stomach (fundus to pylorus). Otherwise set `start`, `end` or
    `reverse`.

    Args:
        mesh: The wall of one lumen [m]; its ends may be open.
        voxel: Edge length of the voxels [m]; by default 1/10 of the lumen's mean radius, or more if
            a lumen with a rough wall would have over 8 million voxels. It is refined, within that
            limit, where a narrow passage would be closed.
        start: Oral end [m], a point inside the lumen.
        end: Anal end [m], a point inside the lumen.
        reverse: Whether the narrower end is the oral end; only without `start` and `end`.

    Raises:
        InputError: If there is no lumen, an end lies outside it, or no curve stays clear of the
            wall.
    """
    vertices, faces = np.asarray(mesh.vertices, float), mesh.faces
    if reverse and (start is not None or end is not None):
        raise InputError("A centerline takes either start and end points or reverse, not both.")
    if voxel is not None and not (np.isfinite(voxel) and voxel > 0.0):
        raise InputError(f"The voxel is {voxel} m. Give a positive length in meters.")
    radius = mean_radius(vertices, faces)
    # A rough wall has a large area and so a small mean radius, which would give too fine voxels.
    volume = 0.5 * radius * float(triangle_areas(vertices[faces]).sum())
    least = (volume / _MAX_INSIDE) ** (1 / 3)
    if voxel is None:
        voxel = max(radius / _VOXELS_PER_RADIUS, least)
    centerline = _trace(mesh, (voxel, least), start, end)
    if start is None and end is None and _widens(centerline) != reverse:
        return reversed_centerline(centerline)
    return centerline


def _trace(
    mesh: Mesh,
    voxels: tuple[float, float],
    start: Float[np.ndarray, " 3"] | None,
    end: Float[np.ndarray, " 3"] | None,
) -> Centerline:
    """Trace the curve on ever finer voxels; on the finest it may also cross closed passages.

    Args:
        mesh: The wall.
        voxels: Edge length of the first voxels and minimum edge length [m].
        start: Oral end [m], or None.
        end: Anal end [m], or None.

    Raises:
        InputError: If no curve stays clear of the wall.
    """
    vertices, faces = np.asarray(mesh.vertices, float), mesh.faces
    voxel, least = voxels
    least = max(least, 1.1 * float(np.prod(np.ptp(vertices, axis=0)) / MAX_VOXELS) ** (1 / 3))
    finer = [voxel / 1.5**level for level in range(1, _REFINEMENTS + 1)]
    sizes = [voxel, *(size for size in finer if size > least)]
    closed = close_ends(vertices, faces)
    handles = num_handles(closed[1])
    for level, size in enumerate(sizes):
        grid = voxelize(vertices, faces, size)
        grid, num_cut = without_short_cuts(grid) if handles else (grid, 0)
        is_last = level == len(sizes) - 1
        path = find_path(grid, start, end)
        if path is None and is_last:  # search all voxels, including those of the tissue
            path = find_path(grid, start, end, cross_gaps=True)
        if path is None and (pieces := num_pieces(closed[1])) > 1:
            raise InputError(f"The wall is in {pieces} pieces. Give that of one lumen, repaired.")
        if path is None:
            _log.info("lumen is in parts at voxels of %.2g m", size)
            continue
        try:
            curve = smooth_path(grid, path, (start is None, end is None))
            if start is None:
                curve = to_wall(grid, curve[::-1], *closed)[::-1]
            if end is None:
                curve = to_wall(grid, curve, *closed)
            centerline = centerline_from_points(curve, vertices, faces)
            _warn(grid, centerline, handles, num_cut)
            return centerline
        except InputError:
            if is_last:
                raise
    raise InputError("The lumen is in parts that no path connects. Repair the mesh first.")


def _warn(grid: LumenGrid, centerline: Centerline, handles: int, num_cut: int) -> None:
    """Warn of touching loops that were separated, and of parts of the lumen the curve omits."""
    if num_cut:
        _log.warning(
            "the wall has %d handles: loops that touch are open to each other; the centerline goes "
            "around the lumen, not through these places",
            handles,
        )
    left_out = _left_out(grid, centerline)
    if left_out > _MAX_LEFT_OUT:
        _log.warning(
            "THE CENTERLINE LEAVES OUT %.0f %% OF THE LUMEN: it jumps from loop to loop or goes "
            "into one branch only. Its length and segments are wrong. Part touching loops in the "
            "mask or mesh (%d handles), or give points along the lumen",
            100.0 * left_out,
            handles,
        )


def _left_out(grid: LumenGrid, centerline: Centerline) -> float:
    """Fraction of the lumen farther from the curve than 3 of its local radii."""
    ids = np.argwhere(grid.inside)
    points = grid.points(ids[:: max(1, len(ids) // _NUM_PROBES)])
    away, nearest = scipy.spatial.KDTree(centerline.points).query(points)
    return float((away > _REACH * np.maximum(centerline.radius[nearest], grid.voxel)).mean())


def _widens(centerline: Centerline) -> bool:
    """Check whether the lumen is wider near the last point than near the first."""
    count = max(1, round(_END_FRACTION * len(centerline.radius)))
    return bool(centerline.radius[-count:].mean() > centerline.radius[:count].mean())


def reversed_centerline(centerline: Centerline) -> Centerline:
    """The same curve in the opposite direction."""
    points, tangents = centerline.points[::-1], -centerline.frames[::-1, :, 2]
    arc_length = centerline.length - centerline.arc_length[::-1]
    radius = centerline.radius[::-1].copy()
    return Centerline(points.copy(), arc_length, radius, transport_frames(points, tangents))
