"""A patient's colon as a labelled, closed triangle surface."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from vrcaps.errors import InputError
from vrcaps.organ.colon.course import generate_course
from vrcaps.organ.colon.crossing import self_intersections
from vrcaps.organ.colon.parameters import SEGMENTS, ColonParameters
from vrcaps.organ.colon.remesh import (
    chart_area,
    collapse_short_edges,
    directed_edges,
    flip_edges,
)
from vrcaps.organ.colon.tube import Tube, make_tube
from vrcaps.organ.colon.wall import Folds, Wall, crest_line, draw_wall, envelope_radius, wall_radius
from vrcaps.organ.surface import Centerline, OrganSurface, vertex_normals
from vrcaps.organ.texture_charts import TubeChart, chart_coordinates
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_ROW_TO_COLUMN = 0.62
"""Spacing of the rows over that of the columns: folds run around the lumen, so rows are denser."""

_NUM_TRIES = 5
_NUM_SMOOTHINGS = 2
_SHORTEST = 0.42
"""Edges shorter than this share of the columns' spacing are merged away."""

_LEAST_GAP = 0.45
"""Share of the rows' even distance that alignment to the folds leaves between them."""

_FREE, _SEAM, _FIXED = 0, 1, 2


@dataclass(frozen=True)
class _Grid:
    """Vertices of a closed tube by their surface coordinates, joined by faces.

    Attributes:
        along: Meridian length from the caecal pole [m].
        theta: Angle, −π at the seam [rad].
        pinned: Free, on the seam, or a pole.
        faces: Vertex numbers, counter-clockwise from inside.
        spacing: Mean distance of the columns [m].
    """

    along: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    pinned: Int[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]
    spacing: float


@dataclass(frozen=True)
class _Meridian:
    """Length along the plain tube's outline: like arc length, but fair over the closed ends."""

    arc_length: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]

    def to_arc_length(self, along: np.ndarray) -> np.ndarray:
        """Arc length [m] of a meridian length [m]."""
        return np.interp(along, self.along, self.arc_length)


def generate_colon(parameters: ColonParameters, *, seed: int) -> OrganSurface:
    """A colon with the given dimensions, different for each seed.

    Args:
        parameters: The patient's dimensions; `ColonParameters.draw` draws a patient.
        seed: Of the course, folds and irregularities.

    Returns:
        A closed surface in the patient frame that nowhere cuts itself, without appearance.

    Raises:
        InputError: If the lumen does not fit into the abdomen.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_NUM_TRIES):
        wall = draw_wall(parameters, make_tube(generate_course(parameters, rng)), rng)
        organ = _mesh(wall, seed)
        if not len(self_intersections(organ.vertices, organ.faces)):
            return organ
    raise InputError(
        f"Found no colon {parameters.length:.2f} m long with {parameters.flexures} flexures that "
        "does not cut itself. Allowed: fewer flexures, smaller diameters, or another seed."
    )


def _mesh(wall: Wall, seed: int) -> OrganSurface:
    """The surface of a wall with about the asked number of triangles, and no fewer."""
    meridian = _meridian(wall.parameters)
    wanted = wall.parameters.triangles
    num_triangles = 0.93 * wanted
    # This yields 2 to 4 % more than asked for most patients.
    grid = _merge_crowded(_make_grid(wall, meridian, num_triangles), wall, meridian)
    if not 1.0 <= len(grid.faces) / wanted <= 1.06:
        num_triangles *= 1.03 * wanted / len(grid.faces)
        grid = _merge_crowded(_make_grid(wall, meridian, num_triangles), wall, meridian)
    return _as_organ(_improve(grid, wall, meridian), wall, meridian, seed)


def _meridian(parameters: ColonParameters) -> _Meridian:
    """Outline of the plain tube, sampled densely where it closes."""
    middle = np.linspace(0.0, parameters.length, 8001)
    near = 0.05 * np.linspace(0.0, 1.0, 400) ** 2
    s = np.unique(np.concatenate([middle, near, parameters.length - near]))
    steps = np.hypot(np.diff(s), np.diff(envelope_radius(parameters, s)))
    return _Meridian(s, np.concatenate([[0.0], np.cumsum(steps)]))


def _surface(wall: Wall, s: np.ndarray, theta: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Positions of the wall [m] at arc lengths and angles."""
    return wall.tube.points(s, theta, wall_radius(wall, s, theta))


def _make_grid(wall: Wall, meridian: _Meridian, num_triangles: float) -> _Grid:
    """Staggered rows of equal vertex number, drawn together where the wall is steep."""
    length = meridian.along[-1]
    radius = envelope_radius(wall.parameters, meridian.arc_length)
    around = 2.0 * np.pi * np.average(radius, weights=np.gradient(meridian.along))
    columns = round(np.sqrt(0.56 * num_triangles * _ROW_TO_COLUMN * around / length))
    rows = 2 * round(0.28 * num_triangles / columns)
    # Wide segments have wider columns, and so wider rows.
    density = np.maximum(radius, 0.5 * radius.mean()) ** -0.5
    count = np.concatenate(
        [[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(meridian.along))]
    )
    along = np.interp(np.linspace(0.0, count[-1], rows + 1)[1:-1], count, meridian.along)
    angles = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    shifted = along[:, None] + _equalise(wall, meridian, along, angles)
    middle = 0.5 * (shifted[1::2] + np.roll(shifted[1::2], -1, axis=1))
    # Odd rows lie half a column aside, with one vertex more on the seam.
    odd = np.concatenate([shifted[1::2, :1], middle], axis=1)
    odd_angles = np.concatenate([angles[:1], angles + np.pi / columns])
    all_along, all_theta = [np.zeros(1)], [np.zeros(1)]
    starts = np.concatenate([[0], np.cumsum(columns + np.arange(rows - 1) % 2)]) + 1
    for i in range(rows - 1):
        all_along.append(odd[i // 2] if i % 2 else shifted[i])
        all_theta.append(odd_angles if i % 2 else angles)
    along = np.concatenate([*all_along, [length]])
    theta = np.concatenate([*all_theta, np.zeros(1)])
    pinned = np.where(theta <= -np.pi, _SEAM, _FREE)
    pinned[[0, -1]] = _FIXED
    faces = _join_rows(starts, columns)
    return _Grid(along, theta, pinned, faces, around / columns)


def _equalise(
    wall: Wall, meridian: _Meridian, along: np.ndarray, angles: np.ndarray
) -> Float[np.ndarray, "rows columns"]:
    """Shift of each vertex along its column that evens out the distances on folds [m]."""
    shape = (len(along), len(angles))
    theta = np.broadcast_to(angles, shape).ravel()
    shift = np.zeros(shape)
    for _ in range(2):
        s = meridian.to_arc_length((along[:, None] + shift).ravel())
        points = _surface(wall, s, theta).reshape(*shape, 3)
        step = np.linalg.norm(np.diff(points, axis=0), axis=2)
        step = uniform_filter1d(step, 3, axis=0)
        local = uniform_filter1d(step, 31, axis=0)
        count = np.concatenate([np.zeros((1, shape[1])), np.cumsum(step / local, axis=0)])
        new = np.empty(shape)
        for j in range(shape[1]):
            ticks = np.linspace(0.0, count[-1, j], shape[0])
            new[:, j] = np.interp(ticks, count[:, j], along + shift[:, j])
        shift = new - along[:, None]
        for _ in range(2):
            shift = _smooth_around(shift)
    for strip in (*wall.strips, wall.valves):
        shift += _align_rows(strip, wall, meridian, along[:, None] + shift, angles)
    ramp = np.clip(np.minimum(np.arange(shape[0]), np.arange(shape[0])[::-1]) / 15.0, 0.0, 1.0)
    return _in_order(along[:, None], _smooth_around(shift) * ramp[:, None])


def _smooth_around(shift: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Mean with both neighbours in the row, weights 1, 2, 1."""
    return 0.25 * (np.roll(shift, 1, axis=1) + 2.0 * shift + np.roll(shift, -1, axis=1))


def _in_order(
    along: Float[np.ndarray, "rows 1"], shift: Float[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "rows columns"]:
    """The shift nearest in its largest change that keeps `_LEAST_GAP` of each distance of rows.

    Taken midway between the least such rows above the given ones and the greatest below.
    """
    rest = shift + (1.0 - _LEAST_GAP) * along
    above = np.maximum.accumulate(rest, axis=0)
    below = np.minimum.accumulate(rest[::-1], axis=0)[::-1]
    return 0.5 * (above + below) - (1.0 - _LEAST_GAP) * along


def _align_rows(
    folds: Folds, wall: Wall, meridian: _Meridian, along: np.ndarray, angles: np.ndarray
) -> Float[np.ndarray, "rows columns"]:
    """Shift of the vertices that lays one row along the crest of each fold [m]."""
    shift = np.zeros_like(along)
    num_rows = len(along)
    for k, s in enumerate(folds.arc_length):
        position, offset = crest_line(folds, k, wall, angles)
        crest = np.interp(position, meridian.arc_length, meridian.along)
        middle = np.argmin(np.abs(offset))
        row = int(
            np.argmin(np.abs(along[:, middle] - np.interp(s, meridian.arc_length, meridian.along)))
        )
        share = np.clip(1.3 * (1.0 - np.abs(offset) / folds.extent[k]), 0.0, 1.0) ** 0.5
        near = np.arange(max(row - 12, 0), min(row + 13, num_rows))
        falloff = np.exp(-(((near - row) / 5.0) ** 2))
        shift[near] += falloff[:, None] * share * (crest - along[row] - shift[row])
    return shift


def _join_rows(starts: np.ndarray, columns: int) -> Int[np.ndarray, "m 3"]:
    """Faces between staggered rows and to the two poles."""
    even_ids = np.arange(columns + 1) % columns
    odd_ids = np.arange(columns + 2) % (columns + 1)
    faces = []
    for i in range(len(starts) - 2):
        flip = i % 2 == 1
        even = starts[i + flip] + even_ids
        odd = starts[i + 1 - flip] + odd_ids
        wide = np.stack([even, odd[:-1], odd[1:]], axis=1)
        narrow = np.stack([even[:-1], odd[1:-1], even[1:]], axis=1)
        faces += [f[:, ::-1] if flip else f for f in (wide, narrow)]
    first = starts[0] + even_ids
    is_odd = len(starts) % 2 == 1
    last = starts[-2] + (odd_ids if is_odd else even_ids)
    pole = np.zeros(columns, int)
    faces.append(np.stack([pole, first[:-1], first[1:]], axis=1))
    faces.append(np.stack([last[:-1], np.full(len(last) - 1, starts[-1]), last[1:]], axis=1))
    return np.concatenate(faces)


def _merge_crowded(grid: _Grid, wall: Wall, meridian: _Meridian) -> _Grid:
    """Merge vertices that crowd where the tube closes and on the inside of bends."""
    points = _surface(wall, meridian.to_arc_length(grid.along), grid.theta)
    shortest = _SHORTEST * grid.spacing
    chart = np.stack([grid.along, grid.theta], axis=1)
    faces = collapse_short_edges(points, chart, grid.faces, grid.pinned, shortest)
    used = np.unique(faces)
    number = np.zeros(len(points), int)
    number[used] = np.arange(len(used))
    return _Grid(grid.along[used], grid.theta[used], grid.pinned[used], number[faces], grid.spacing)


def _improve(grid: _Grid, wall: Wall, meridian: _Meridian) -> _Grid:
    """Flip edges to Delaunay and even out the vertices around irregular places."""
    along, theta, faces, pinned = grid.along, grid.theta, grid.faces, grid.pinned
    for i in range(_NUM_SMOOTHINGS + 1):
        points = _surface(wall, meridian.to_arc_length(along), theta)
        faces = flip_edges(points, np.stack([along, theta], axis=1), faces, pinned)
        if i < _NUM_SMOOTHINGS:
            along, theta = _even_out(along, theta, pinned, faces, meridian, wall)
    return _Grid(along, theta, pinned, faces, grid.spacing)


def _even_out(along, theta, pinned, faces, meridian, wall) -> tuple[np.ndarray, np.ndarray]:
    """Half a step of each free vertex towards the mean of its neighbours' coordinates."""
    ends = directed_edges(faces)
    turn = theta[ends[:, 1]] - theta[ends[:, 0]]
    turn = np.mod(turn + np.pi, 2.0 * np.pi) - np.pi
    count = np.bincount(ends[:, 0], minlength=len(along))
    shift = np.bincount(ends[:, 0], along[ends[:, 1]] - along[ends[:, 0]], len(along)) / count
    turn = np.bincount(ends[:, 0], turn, len(along)) / count
    radius = envelope_radius(wall.parameters, meridian.to_arc_length(along))
    # Regular neighbourhoods stay: their rows follow the crests of the folds.
    is_irregular = count != 6
    is_irregular[ends[is_irregular[ends[:, 1]], 0]] = True
    weight = np.where(is_irregular & (pinned == _FREE) & (radius > 5 * MM), 0.5, 0.0)
    for _ in range(4):
        moved = np.stack([along + weight * shift, theta + weight * turn], axis=1)
        weight[faces[chart_area(moved, faces) <= 0.0]] = 0.0
    new_theta = theta + weight * turn
    is_inside = np.abs(new_theta) < np.pi - 1e-6
    return along + weight * shift, np.where((pinned == _FREE) & is_inside, new_theta, theta)


def _turns(grid: _Grid) -> Float[np.ndarray, "m 3"]:
    """Way back around the tube from the seam, 0 to 1, at each corner, without jumps in faces."""
    pinned = grid.pinned[grid.faces]
    theta = grid.theta[grid.faces]
    is_free = pinned == _FREE
    side = np.sum(np.where(is_free, theta, 0.0), axis=1, keepdims=True)
    theta = np.where((pinned == _SEAM) & (side > 0.0), np.pi, theta)
    turn = 0.5 - theta / (2.0 * np.pi)
    is_pole = pinned == _FIXED
    others = np.sum(np.where(is_pole, 0.0, turn), axis=1, keepdims=True) / np.sum(
        ~is_pole, axis=1, keepdims=True
    )
    return np.where(is_pole, others, turn)


def _as_organ(grid: _Grid, wall: Wall, meridian: _Meridian, seed: int) -> OrganSurface:
    """The finished surface with labels, gut coordinates and centreline."""
    parameters = wall.parameters
    s = meridian.to_arc_length(grid.along)
    radius = wall_radius(wall, s, grid.theta)
    vertices = wall.tube.points(s, grid.theta, radius)
    ends = np.cumsum([segment.length for segment in parameters.segments])[:-1]
    return OrganSurface(
        name="colon",
        vertices=vertices,
        faces=grid.faces.astype(np.int32),
        normals=vertex_normals(vertices, grid.faces),
        uv=chart_coordinates(
            TubeChart(grid.faces, vertices[grid.faces], _turns(grid), grid.along[grid.faces])
        ),
        label=(1 + np.searchsorted(ends, s, side="right")).astype(np.uint8),
        label_names=("background", *SEGMENTS),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=s,
        theta=grid.theta,
        radius=radius,
        centerline=_centerline(wall.tube, vertices),
        metadata={"generator": "colon", "seed": seed, "parameters": asdict(parameters)},
    )


def _centerline(tube: Tube, vertices: np.ndarray) -> Centerline:
    """The course with the clearance to the nearest vertex of the wall."""
    points = tube.curve(tube.arc_length)
    clearance, _ = KDTree(vertices).query(points)
    return Centerline(points, tube.arc_length, clearance, tube.frames)
