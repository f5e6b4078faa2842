"""Tube mesher: rows of vertices around a tube, and Delaunay triangles between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.tube_mesh.swept_surface import (
    FREE,
    POLE,
    SEAM,
    Crests,
    Grid,
    Meridian,
    SweptSurface,
    make_meridian,
    wrap,
)
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh, area_vectors, directed_edges, find_edges

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


def chart_area(
    chart: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " m"]:
    """Area of each face in the chart (along [m], θ [rad]), negative if it is flipped over."""
    one, two = (chart[faces[:, k]] - chart[faces[:, 0]] for k in (1, 2))
    for offset in (one, two):
        offset[:, 1] = wrap(offset[:, 1])
    return 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


def flip_edges(
    vertices: Float[np.ndarray, "n 3"],
    chart: Float[np.ndarray, "n 2"],
    faces: Int[np.ndarray, "m 3"],
    pinned: Int[np.ndarray, " n"],
    num_rounds: int = 3,
) -> Int[np.ndarray, "m 3"]:
    """Flip edges that are not Delaunay, on nearly flat pairs of faces only.

    Edges between two seam vertices and faces at the poles are kept, and no face flips over in
    the chart.

    Args:
        vertices: Positions [m].
        chart: Meridian length [m] and angle [rad] of each vertex.
        faces: Vertex indices.
        pinned: `FREE`, `SEAM` or `POLE` of each vertex.
        num_rounds: Maximum number of rounds of flips.
    """
    faces = faces.copy()
    for _ in range(num_rounds):
        halves = find_edges(faces)
        pair = halves.with_count(2)
        edges, pair_faces = np.sort(halves.ends[pair[:, 0]], axis=1), pair // 3
        apex = faces.ravel()[3 * pair_faces + (pair + 2) % 3]
        a, b = (vertices.take(edges[:, k], axis=0) for k in range(2))  # faster than an index
        is_seam, is_pole = pinned > 0, pinned > 1
        one, other = (_cotangent(a, vertices.take(apex[:, k], axis=0), b) for k in range(2))
        excess = -(one + other)
        # The two opposite angles add up to more than π if the sum of their cotangents is negative.
        want = (excess > 1e-3) & ~(is_seam[edges[:, 0]] & is_seam[edges[:, 1]])
        # Seam vertices on both sides would give an edge along or across the seam.
        want &= ~(is_seam[apex[:, 0]] & is_seam[apex[:, 1]])
        for end in (*edges.T, *apex.T):
            want &= ~is_pole[end]
        normals = area_vectors(Mesh(vertices, faces))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        one, other = normals[pair_faces[want].T]
        want[want] = np.sum(one * other, axis=1) > 0.7
        want[want] = ~_is_in(np.sort(apex[want], axis=1), edges, len(vertices))
        chosen = _independent_flips(np.flatnonzero(want), excess, pair_faces, len(faces))
        chosen = _distinct_flips(chosen, apex)
        if not len(chosen):
            break
        _flip(vertices, chart, faces, (edges[chosen], pair_faces[chosen], apex[chosen]))
    return faces


def _independent_flips(
    candidates: np.ndarray, excess: np.ndarray, pair_faces: np.ndarray, num_faces: int
) -> Int[np.ndarray, " k"]:
    """Candidates that share no face, worst edges first."""
    order = candidates[np.argsort(-excess[candidates], kind="stable")]
    rank = np.full(num_faces, len(order))
    np.minimum.at(rank, pair_faces[order].ravel(), np.repeat(np.arange(len(order)), 2))
    return order[(rank[pair_faces[order]] == np.arange(len(order))[:, None]).all(axis=1)]


def _distinct_flips(chosen: Int[np.ndarray, " k"], apex: np.ndarray) -> Int[np.ndarray, " l"]:
    """Flips without pairs that create the same edge, which would then have four faces."""
    _, first = np.unique(np.sort(apex[chosen], axis=1), axis=0, return_index=True)
    return chosen[np.sort(first)]


def _flip(
    vertices: np.ndarray,
    chart: np.ndarray,
    faces: np.ndarray,
    flips: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Replace the two faces of each edge by those of the other diagonal, where valid."""
    edges, pair_faces, apex = flips
    first = faces[pair_faces[:, 0]]
    # Direction in which the first face traverses the edge.
    is_forward = (np.roll(first, -1, axis=1) == edges[:, 1:]) & (first == edges[:, :1])
    start = np.where(is_forward.any(axis=1), edges[:, 0], edges[:, 1])
    end = edges.sum(axis=1) - start
    one = np.stack([start, apex[:, 1], apex[:, 0]], axis=1)
    two = np.stack([end, apex[:, 0], apex[:, 1]], axis=1)
    before = area_vectors(Mesh(vertices, first))
    is_sound = np.ones(len(edges), bool)
    for new in (one, two):
        is_sound &= chart_area(chart, new) > 0.0
        is_sound &= np.sum(area_vectors(Mesh(vertices, new)) * before, axis=1) > 0.0
    faces[pair_faces[is_sound, 0]] = one[is_sound]
    faces[pair_faces[is_sound, 1]] = two[is_sound]


def _is_in(pairs: np.ndarray, edges: np.ndarray, num_vertices: int) -> Bool[np.ndarray, " n"]:
    """Check which pairs are among the sorted edges."""
    known = edges[:, 0] * num_vertices + edges[:, 1]
    key = pairs[:, 0] * num_vertices + pairs[:, 1]
    return known[np.minimum(np.searchsorted(known, key), len(known) - 1)] == key


def _cotangent(a: np.ndarray, apex: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cotangent of the angle at the apex between a and b."""
    u, v = a - apex, b - apex
    dot = np.einsum("ij,ij->i", u, v)
    square = np.einsum("ij,ij->i", u, u) * np.einsum("ij,ij->i", v, v) - dot * dot
    return dot / np.sqrt(np.maximum(square, 1e-30))


_NUM_ANGLES = 36
_NUM_FINE_ANGLES = 240
_STEP, _COARSE_STEP = 0.4 * MM, 2 * MM
_ROW_TO_COLUMN = 0.8
"""Ratio of row to column spacing; √3/2 makes staggered triangles equilateral."""
_LOCAL = 25 * MM
_DRIFT = 70 * MM
_MIN_SIDES = 6
_MIN_GAP = 0.33
"""Minimum fraction of the plain row spacing that equal steps over folds may leave."""
_STRAIGHT = 15
"""Number of rows over which columns keep their direction."""
_CREST_REACH = 12
_CREST_FADE = 5.0
"""Rows next to a crest that move along with it, and distance at which they do by about a third."""


def mesh_swept_surface(surface: SweptSurface, *, num_smoothings: int = 2) -> Grid:
    """Mesh a wall with well-shaped triangles, denser where it is steep.

    Args:
        surface: The wall.
        num_smoothings: Number of rounds that move vertices to the center of their neighbors.
    """
    meridian = make_meridian(surface)
    angles = np.linspace(-np.pi, np.pi, _NUM_ANGLES, endpoint=False)
    rows = _place_rows(surface, meridian, angles)
    grid = _join(*_place_columns(surface, meridian, rows, angles), meridian.along[-1])
    return _improve(grid, surface, meridian, num_smoothings)


def count_triangles(surface: SweptSurface) -> float:
    """Approximate number of triangles of `mesh_swept_surface`."""
    meridian = make_meridian(surface)
    end = meridian.along[-1]
    along = np.linspace(0.0, end, round(end / _COARSE_STEP) + 1)
    pace = _pace(surface, meridian, along, np.linspace(-np.pi, np.pi, _NUM_ANGLES, endpoint=False))
    middle = meridian.to_arc_length(0.5 * (along[1:] + along[:-1]))
    girth = _steps_around(surface, middle, np.linspace(-np.pi, np.pi, 2 * _NUM_ANGLES + 1)).sum(
        axis=1
    )
    rows = pace.mean(axis=1) * np.diff(along) / (_ROW_TO_COLUMN * surface.edge(middle))
    return float(np.sum(2.0 * rows * girth / surface.edge(middle)))


def _place_rows(
    surface: SweptSurface, meridian: Meridian, angles: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "rows k"]:
    """Meridian length [m] of each row at each angle, with even steps over folds and plain wall."""
    end = meridian.along[-1]
    along = np.linspace(0.0, end, round(end / _STEP) + 1)
    pace = _pace(surface, meridian, along, angles)
    mean = pace.mean(axis=1)
    middle = 0.5 * (along[1:] + along[:-1])
    ticks = _ROW_TO_COLUMN * surface.edge(meridian.to_arc_length(middle)) / np.diff(along)
    count = np.concatenate([[0.0], np.cumsum(mean / ticks)])
    num_rows = round(count[-1]) - 1
    base = np.interp(np.linspace(0.0, count[-1], num_rows + 2)[1:-1], count, along)
    window = round(_LOCAL / _STEP)
    relative = pace / scipy.ndimage.uniform_filter1d(pace, window, axis=0)
    relative *= (scipy.ndimage.uniform_filter1d(mean, window) / ticks)[:, None]
    shift = np.empty((num_rows, len(angles)))
    for k in range(len(angles)):
        own = np.concatenate([[0.0], np.cumsum(relative[:, k])])
        density = np.linspace(0.0, own[-1], num_rows + 2)[1:-1]
        shift[:, k] = np.interp(density, own, along) - base
    shift -= scipy.ndimage.uniform_filter1d(shift, max(3, round(_DRIFT / end * num_rows)), axis=0)
    shift = _smooth_around(_smooth_around(shift))
    if surface.crests is not None:
        shift = _smooth_around(
            shift + _towards_crests(base[:, None] + shift, surface.crests(angles), meridian)
        )
    from_end = np.minimum(np.arange(num_rows), np.arange(num_rows)[::-1])
    shift *= np.clip(from_end / 12.0, 0.0, 1.0)[:, None]
    return _in_order(base, shift)


def _smooth_around(rows: Float[np.ndarray, "rows k"]) -> Float[np.ndarray, "rows k"]:
    """Average with both neighbors around the tube, with weights 1, 2, 1."""
    return 0.25 * (np.roll(rows, 1, axis=1) + 2.0 * rows + np.roll(rows, -1, axis=1))


def _towards_crests(
    rows: Float[np.ndarray, "rows k"], crests: Crests, meridian: Meridian
) -> Float[np.ndarray, "rows k"]:
    """Shift [m] that aligns the nearest row with each crest and moves its neighbors along."""
    shift = np.zeros_like(rows)
    for along, weight in zip(meridian.to_along(crests.arc_length), crests.weight, strict=True):
        middle = np.argmax(weight)
        row = int(np.argmin(np.abs(rows[:, middle] + shift[:, middle] - along[middle])))
        near = np.arange(max(row - _CREST_REACH, 0), min(row + _CREST_REACH + 1, len(rows)))
        fade = np.exp(-(((near - row) / _CREST_FADE) ** 2))
        shift[near] += fade[:, None] * weight * (along - rows[row] - shift[row])
    return shift


def _pace(
    surface: SweptSurface, meridian: Meridian, along: np.ndarray, angles: np.ndarray
) -> Float[np.ndarray, "n k"]:
    """Length of wall per meridian length at each angle [m]."""
    shape = (len(along), len(angles))
    s = np.repeat(meridian.to_arc_length(along), len(angles))
    points = surface.points(s, np.tile(angles, len(along))).reshape(*shape, 3)
    pace = np.linalg.norm(np.diff(points, axis=0), axis=2) / np.diff(along)[:, None]
    return np.maximum(scipy.ndimage.uniform_filter1d(pace, 3, axis=0), 0.05)


def _in_order(
    base: Float[np.ndarray, " rows"], shift: Float[np.ndarray, "rows k"]
) -> Float[np.ndarray, "rows k"]:
    """Shifted rows, kept `_MIN_GAP` of their plain distance apart by the smallest maximum change.

    They are midway between the lowest such rows above the shifted ones and the highest below.
    """
    floor = _MIN_GAP * base[:, None]
    rest = base[:, None] + shift - floor
    above = np.maximum.accumulate(rest, axis=0)
    below = np.minimum.accumulate(rest[::-1], axis=0)[::-1]
    return 0.5 * (above + below) + floor


def _place_columns(
    surface: SweptSurface, meridian: Meridian, rows: np.ndarray, angles: np.ndarray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " rows"]]:
    """Meridian length and angle of each vertex, and number of vertices of each row.

    The vertices of a row are evenly spaced around its section, with the first on the seam. Every
    other row is staggered by half a spacing and has one vertex more.
    """
    fine = np.linspace(-np.pi, np.pi, _NUM_FINE_ANGLES + 1)
    middle = rows.mean(axis=1)
    step = _steps_around(surface, meridian.to_arc_length(middle), fine)
    girth = step.sum(axis=1)
    # Averaged over many rows, so that columns do not weave in and out of folds.
    fraction = scipy.ndimage.uniform_filter1d(step / girth[:, None], _STRAIGHT, axis=0)
    fraction = np.pad(np.cumsum(fraction, axis=1), ((0, 0), (1, 0)))
    plain = 2.0 * np.pi * np.maximum(surface.envelope(meridian.to_arc_length(middle)), 0.1 * MM)
    ratio = scipy.ndimage.uniform_filter1d(np.clip(girth / plain, 0.5, 3.0), 25)
    density = plain * ratio / surface.edge(meridian.to_arc_length(middle))
    num_columns = _steady(np.maximum(density, _MIN_SIDES))
    all_along, all_theta = [], []
    ring = np.append(angles, np.pi)
    for i, columns in enumerate(num_columns):
        ticks = np.arange(columns) / columns
        if i % 2:
            ticks = np.concatenate([[0.0], ticks + 0.5 / columns])
        theta = np.interp(ticks * fraction[i, -1], fraction[i], fine)
        all_theta.append(theta)
        all_along.append(np.interp(theta, ring, np.append(rows[i], rows[i, 0])))
    count = num_columns + np.arange(len(rows)) % 2
    return np.concatenate(all_along), np.concatenate(all_theta), count


def _steps_around(
    surface: SweptSurface, arc_length: Float[np.ndarray, " n"], angles: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "n k-1"]:
    """Distances [m] between points of the wall at successive angles, for each section."""
    s = np.repeat(arc_length, len(angles))
    radius = surface.radius(s, np.tile(angles, len(arc_length))).reshape(len(arc_length), -1)
    across = 0.5 * (radius[:, 1:] + radius[:, :-1]) * np.diff(angles)
    return np.hypot(np.diff(radius, axis=1), across)


def _steady(density: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Integers near the given values that change only when they are off by more than 4 %."""
    steady, current = np.empty(len(density), int), round(density[0])
    for i, value in enumerate(density):
        if abs(value - current) > 0.5 + 0.04 * value:
            current = round(value)
        steady[i] = current
    return steady


def _join(along: np.ndarray, theta: np.ndarray, count: np.ndarray, end: float) -> Grid:
    """Faces between neighboring rows of any numbers of vertices, and to the two poles."""
    start = np.concatenate([[0], np.cumsum(count)])
    row = np.repeat(np.arange(len(count)), count)
    following = np.arange(len(along)) + 1
    following[start[1:] - 1] = start[:-1]
    after = np.where(following > np.arange(len(along)), theta[following], np.pi)
    # Midpoint of each edge as a fraction of the circumference, plus its row: a global sort key.
    key = row + (0.5 * (theta + after) + np.pi) / (2.0 * np.pi)
    lower, upper = row < len(count) - 1, row > 0
    above = np.searchsorted(key, key[lower] + 1.0, side="left")
    below = np.searchsorted(key, key[upper] - 1.0, side="right")
    wrapped = [
        np.where(index == start[r + 1], start[r], index)
        for index, r in ((above, row[lower] + 1), (below, row[upper] - 1))
    ]
    ids = np.arange(len(along))
    first, last = ids[row == 0], ids[row == len(count) - 1]
    num = len(along)
    faces = [
        np.stack([ids[lower], wrapped[0], following[lower]], axis=1),
        np.stack([wrapped[1], ids[upper], following[upper]], axis=1),
        np.stack([np.full(len(first), num), first, following[first]], axis=1),
        np.stack([last, np.full(len(last), num + 1), following[last]], axis=1),
    ]
    pinned = np.full(num + 2, FREE)
    pinned[start[:-1]] = SEAM
    pinned[num:] = POLE
    along = np.concatenate([along, [0.0, end]])
    return Grid(along, np.concatenate([theta, [0.0, 0.0]]), pinned, np.concatenate(faces))


def _improve(grid: Grid, surface: SweptSurface, meridian: Meridian, num_smoothings: int) -> Grid:
    """Flip edges to Delaunay and even out the vertices."""
    along, theta, faces = grid.along, grid.theta, grid.faces
    for i in range(num_smoothings + 1):
        points = surface.points(meridian.to_arc_length(along), theta)
        faces = flip_edges(points, np.stack([along, theta], axis=1), faces, grid.pinned)
        if i < num_smoothings:
            along, theta = _even_out(Grid(along, theta, grid.pinned, faces))
    return Grid(along, theta, grid.pinned, faces)


def _even_out(grid: Grid) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Move each free vertex halfway towards the mean of its neighbors' coordinates."""
    along, theta, faces = grid.along, grid.theta, grid.faces
    ends = directed_edges(faces)
    delta_theta = wrap(theta[ends[:, 1]] - theta[ends[:, 0]])
    count = np.bincount(ends[:, 0], minlength=len(along))
    shift = np.bincount(ends[:, 0], along[ends[:, 1]] - along[ends[:, 0]], len(along)) / count
    delta_theta = np.bincount(ends[:, 0], delta_theta, len(along)) / count
    is_moved = grid.pinned == FREE
    is_moved[ends[grid.pinned[ends[:, 1]] == POLE, 0]] = False
    weight = np.where(is_moved, 0.5, 0.0)
    for _ in range(4):
        moved = np.stack([along + weight * shift, theta + weight * delta_theta], axis=1)
        weight[faces[chart_area(moved, faces) <= 0.0]] = 0.0
    new_theta = theta + weight * delta_theta
    is_inside = np.abs(new_theta) < np.pi - 1e-6
    return (
        np.where(is_inside, along + weight * shift, along),
        np.where(is_inside, new_theta, theta),
    )
