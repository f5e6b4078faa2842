"""Centerlines: smooth curves through a lumen, computed from its surface or through given points."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas
from vrcaps.mesh.mesh import Mesh, wall_distance
from vrcaps.organ.lumen_grid import (
    MAX_VOXELS,
    LumenGrid,
    close_ends,
    mean_radius,
    num_handles,
    num_pieces,
    voxelize,
    without_short_cuts,
)
from vrcaps.organ.lumen_path import find_path, smooth_path, to_wall
from vrcaps.organ.surface import Centerline

if TYPE_CHECKING:
    from jaxtyping import Float, Int


_STEPS_PER_RADIUS = 16.0
_MAX_SAMPLES = 20_000


def centerline_from_points(
    points: Float[np.ndarray, "k 3"],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    step: float | None = None,
) -> Centerline:
    """Smooth curve through points along a lumen, from the oral to the anal end.

    Args:
        points: Points along the lumen [m]; a cubic spline passes through all of them.
        vertices: Vertices of the wall [m], same frame.
        faces: Faces of the wall.
        step: Distance between samples [m]; by default 1/16 of the median radius.

    Raises:
        InputError: If the points form no curve, or the curve crosses or touches the wall.
    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise InputError(f"Centerline points have shape {points.shape}. Give finite points [n 3].")
    keep = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.0)
    if np.count_nonzero(keep) < 2:
        raise InputError("A centerline needs at least 2 different points.")
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points[keep], axis=0), axis=1)))
    spline = scipy.interpolate.CubicSpline(chord, points[keep])
    if step is None:
        coarse = spline(np.linspace(0.0, chord[-1], 50))
        step = float(np.median(wall_distance(coarse, vertices, faces))) / _STEPS_PER_RADIUS
    num = int(np.clip(np.ceil(chord[-1] / max(step, chord[-1] / _MAX_SAMPLES)), 8, _MAX_SAMPLES))
    at = _uniform(spline, chord[-1], num)
    samples, tangents = spline(at), spline(at, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    gaps = np.linalg.norm(np.diff(samples, axis=0), axis=1)
    radius = wall_distance(samples, vertices, faces)
    _check_clear(samples, radius, gaps)
    arc_length = np.append(0.0, np.cumsum(gaps))
    return Centerline(samples, arc_length, radius, transport_frames(samples, tangents))


def _uniform(
    spline: scipy.interpolate.CubicSpline, stop: float, num: int
) -> Float[np.ndarray, " n"]:
    """Parameters of `num` + 1 evenly spaced points along a spline."""
    dense = np.linspace(0.0, stop, 8 * num + 1)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(spline(dense), axis=0), axis=1)))
    return np.interp(np.linspace(0.0, length[-1], num + 1), length, dense)


def _check_clear(
    points: Float[np.ndarray, "n 3"], radius: Float[np.ndarray, " n"], gaps: Float[np.ndarray, " g"]
) -> None:
    """Reject a curve that crosses the wall: each step must lie in the free balls of its ends."""
    blocked = np.flatnonzero(radius[1:] + radius[:-1] <= gaps)
    if len(blocked):
        at = points[blocked[0]]
        raise InputError(
            f"The centerline touches the wall at {at.round(6).tolist()} m and in "
            f"{len(blocked) - 1} other positions. The lumen must be open from end to end."
        )


def transport_frames(
    points: Float[np.ndarray, "n 3"], tangents: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Rotation-minimizing frames along a curve (Wang et al. 2008, double reflection).

    Args:
        points: Samples of the curve.
        tangents: Unit tangents at the samples.

    Returns:
        Rotations; columns are two transverse axes and the tangent. The first transverse axis
        of the first frame is as close as possible to the axis least aligned with the tangent.
    """
    nearest = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    x = nearest - (nearest @ tangents[0]) * tangents[0]
    axes = [x / np.linalg.norm(x)]
    steps = np.diff(points, axis=0)
    for step, tangent, following in zip(steps, tangents[:-1], tangents[1:], strict=True):
        scale = 2.0 / (step @ step)
        x = axes[-1] - scale * (step @ axes[-1]) * step
        reflected = tangent - scale * (step @ tangent) * step
        bend = following - reflected
        if (square := bend @ bend) > 0.0:
            x = x - 2.0 / square * (bend @ x) * bend
        x = x - (x @ following) * following
        axes.append(x / np.linalg.norm(x))
    first = np.array(axes)
    return np.stack([first, np.cross(tangents, first), tangents], axis=-1)


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
        raise InputError("Give a centerline either start and end points or reverse, not both.")
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
            raise InputError(f"The wall has {pieces} components. Give the wall of one lumen.")
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
    raise InputError("The lumen has unconnected parts. Repair the mesh first.")


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
