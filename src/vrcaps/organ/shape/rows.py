"""Rows of vertices around a tube, as many in each as its girth asks for, joined by triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d

from vrcaps.organ.colon.remesh import chart_area, directed_edges, flip_edges
from vrcaps.organ.shape.skin import FREE, POLE, SEAM, Grid, Meridian, Skin, make_meridian
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_NUM_ANGLES = 36
_NUM_FINE_ANGLES = 240
_STEP = 0.4 * MM
_ROW_TO_COLUMN = 0.8
"""Spacing of the rows over that of the columns; √3/2 makes staggered triangles equilateral."""
_LOCAL = 25 * MM
_DRIFT = 70 * MM
_FEWEST = 6


def mesh_skin(skin: Skin, *, num_smoothings: int = 2) -> Grid:
    """Well-shaped triangles over a wall, denser where it is steep.

    Args:
        skin: The wall.
        num_smoothings: Rounds of moving irregular vertices to the middle of their neighbours.
    """
    meridian = make_meridian(skin)
    angles = np.linspace(-np.pi, np.pi, _NUM_ANGLES, endpoint=False)
    rows = _place_rows(skin, meridian, angles)
    grid = _join(*_place_columns(skin, meridian, rows, angles), meridian.along[-1])
    return _improve(grid, skin, meridian, num_smoothings)


def _place_rows(
    skin: Skin, meridian: Meridian, angles: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "rows k"]:
    """Meridian length [m] of each row at each angle: even steps over folds as on plain wall."""
    end = meridian.along[-1]
    along = np.linspace(0.0, end, round(end / _STEP) + 1)
    pace = _pace(skin, meridian, along, angles)
    mean = pace.mean(axis=1)
    middle = 0.5 * (along[1:] + along[:-1])
    ticks = _ROW_TO_COLUMN * skin.edge(meridian.to_arc_length(middle)) / np.diff(along)
    count = np.concatenate([[0.0], np.cumsum(mean / ticks)])
    num_rows = round(count[-1]) - 1
    base = np.interp(np.linspace(0.0, count[-1], num_rows + 2)[1:-1], count, along)
    window = round(_LOCAL / _STEP)
    relative = pace / uniform_filter1d(pace, window, axis=0)
    relative *= (uniform_filter1d(mean, window) / ticks)[:, None]
    shift = np.empty((num_rows, len(angles)))
    for k in range(len(angles)):
        own = np.concatenate([[0.0], np.cumsum(relative[:, k])])
        wanted = np.linspace(0.0, own[-1], num_rows + 2)[1:-1]
        shift[:, k] = np.interp(wanted, own, along) - base
    shift -= uniform_filter1d(shift, max(3, round(_DRIFT / end * num_rows)), axis=0)
    for _ in range(2):
        shift = 0.25 * (np.roll(shift, 1, axis=1) + 2.0 * shift + np.roll(shift, -1, axis=1))
    from_end = np.minimum(np.arange(num_rows), np.arange(num_rows)[::-1])
    shift *= np.clip(from_end / 12.0, 0.0, 1.0)[:, None]
    return _in_order(base[:, None] + shift)


def _pace(
    skin: Skin, meridian: Meridian, along: np.ndarray, angles: np.ndarray
) -> Float[np.ndarray, "n k"]:
    """Length of wall per step of meridian length at each angle [m]."""
    shape = (len(along), len(angles))
    s = np.repeat(meridian.to_arc_length(along), len(angles))
    points = skin.points(s, np.tile(angles, len(along))).reshape(*shape, 3)
    pace = np.linalg.norm(np.diff(points, axis=0), axis=2) / np.diff(along)[:, None]
    return np.maximum(uniform_filter1d(pace, 3, axis=0), 0.05)


def _in_order(rows: Float[np.ndarray, "rows k"]) -> Float[np.ndarray, "rows k"]:
    """Rows pushed apart where they would come nearer than a third of their mean distance."""
    least = 0.33 * np.diff(rows.mean(axis=1))
    floor = np.concatenate([[0.0], np.cumsum(least)])[:, None]
    forward = np.maximum.accumulate(rows - floor, axis=0) + floor
    backward = np.minimum.accumulate((rows - floor)[::-1], axis=0)[::-1] + floor
    return 0.5 * (forward + backward)


def _place_columns(
    skin: Skin, meridian: Meridian, rows: np.ndarray, angles: np.ndarray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " rows"]]:
    """Meridian length, angle of each vertex, and number of vertices of each row.

    A row's vertices lie at even distances around its section, the first on the seam; every
    other row is staggered by half a distance, with one vertex more.
    """
    fine = np.linspace(-np.pi, np.pi, _NUM_FINE_ANGLES + 1)
    middle = rows.mean(axis=1)
    s = np.repeat(meridian.to_arc_length(middle), len(fine))
    radius = skin.radius(s, np.tile(fine, len(rows))).reshape(len(rows), -1)
    step = np.hypot(np.diff(radius, axis=1), 0.5 * (radius[:, 1:] + radius[:, :-1]) * np.diff(fine))
    girth = step.sum(axis=1)
    share = uniform_filter1d(step / girth[:, None], 5, axis=0)
    share = np.pad(np.cumsum(share, axis=1), ((0, 0), (1, 0)))
    plain = 2.0 * np.pi * np.maximum(skin.envelope(meridian.to_arc_length(middle)), 0.1 * MM)
    ratio = uniform_filter1d(np.clip(girth / plain, 0.5, 3.0), 25)
    wanted = plain * ratio / skin.edge(meridian.to_arc_length(middle))
    num_columns = _steady(np.maximum(wanted, _FEWEST))
    all_along, all_theta = [], []
    ring = np.append(angles, np.pi)
    for i, columns in enumerate(num_columns):
        ticks = np.arange(columns) / columns
        if i % 2:
            ticks = np.concatenate([[0.0], ticks + 0.5 / columns])
        theta = np.interp(ticks * share[i, -1], share[i], fine)
        all_theta.append(theta)
        all_along.append(np.interp(theta, ring, np.append(rows[i], rows[i, 0])))
    count = num_columns + np.arange(len(rows)) % 2
    return np.concatenate(all_along), np.concatenate(all_theta), count


def _steady(wanted: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Whole numbers near the wanted ones that change only when they are off by more than 4 %."""
    steady, current = np.empty(len(wanted), int), round(wanted[0])
    for i, value in enumerate(wanted):
        if abs(value - current) > 0.5 + 0.04 * value:
            current = round(value)
        steady[i] = current
    return steady


def _join(along: np.ndarray, theta: np.ndarray, count: np.ndarray, end: float) -> Grid:
    """Faces between neighbouring rows, however many vertices they have, and to two poles."""
    start = np.concatenate([[0], np.cumsum(count)])
    row = np.repeat(np.arange(len(count)), count)
    following = np.arange(len(along)) + 1
    following[start[1:] - 1] = start[:-1]
    after = np.where(following > np.arange(len(along)), theta[following], np.pi)
    # The middle of each edge, as a share of the turn, offset by the row: sorted over all rows.
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


def _improve(grid: Grid, skin: Skin, meridian: Meridian, num_smoothings: int) -> Grid:
    """Flip edges to Delaunay and even out the vertices around irregular places."""
    along, theta, faces = grid.along, grid.theta, grid.faces
    for i in range(num_smoothings + 1):
        points = skin.points(meridian.to_arc_length(along), theta)
        faces = flip_edges(points, np.stack([along, theta], axis=1), faces, grid.pinned)
        if i < num_smoothings:
            along, theta = _even_out(Grid(along, theta, grid.pinned, faces))
    return Grid(along, theta, grid.pinned, faces)


def _even_out(grid: Grid) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Half a step of each irregular free vertex towards the mean of its neighbours' coordinates."""
    along, theta, faces = grid.along, grid.theta, grid.faces
    ends = directed_edges(faces)
    turn = theta[ends[:, 1]] - theta[ends[:, 0]]
    turn = np.mod(turn + np.pi, 2.0 * np.pi) - np.pi
    count = np.bincount(ends[:, 0], minlength=len(along))
    shift = np.bincount(ends[:, 0], along[ends[:, 1]] - along[ends[:, 0]], len(along)) / count
    turn = np.bincount(ends[:, 0], turn, len(along)) / count
    # Regular neighbourhoods stay: their rows follow the crests of the folds.
    is_moved = (count != 6) & (grid.pinned == FREE)
    is_moved[ends[grid.pinned[ends[:, 1]] == POLE, 0]] = False
    weight = np.where(is_moved, 0.5, 0.0)
    for _ in range(4):
        moved = np.stack([along + weight * shift, theta + weight * turn], axis=1)
        weight[faces[chart_area(moved, faces) <= 0.0]] = 0.0
    new_theta = theta + weight * turn
    is_inside = np.abs(new_theta) < np.pi - 1e-6
    return (
        np.where(is_inside, along + weight * shift, along),
        np.where(is_inside, new_theta, theta),
    )
