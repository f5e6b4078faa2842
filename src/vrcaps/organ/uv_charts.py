"""Texture coordinates of a generated tube: small charts, flattened with little stretch."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.geometry import triangle_areas
from vrcaps.core.units import MM
from vrcaps.organ.uv import texture_stretch

if TYPE_CHECKING:
    from jaxtyping import Float, Int

GAP = 1.25 * MM
"""Gap between charts [m of wall]: 10 texels at 8 per mm, half of which extend each chart."""

_SIDE = 30 * MM  # approximate side of a chart
_NUM_ROUNDS = 11
_GROUP = 48  # charts flattened at once
_GROWTH_ROUNDS = (6, 8, 10)
_MAX_GROWTH = 1.25  # maximum growth of a squeezed face per such round
_ANGLES = np.linspace(-0.25, 0.25, 16, endpoint=False) * np.pi
_STEPS = 2.0**26  # coordinate quantization that hides the last bits of the solver


@dataclass(frozen=True)
class TubeChart:
    """Unrolled faces of a tube: positions of their corners around and along it.

    Attributes:
        faces: Vertex indices.
        corners: Positions of the corners [m].
        turn: Fraction of the circumference from the seam, 0 to 1; a corner on the seam takes the
            value of its face's side.
        along: Length along the tube from 0 [m].
    """

    faces: Int[np.ndarray, "m 3"]
    corners: Float[np.ndarray, "m 3 3"]
    turn: Float[np.ndarray, "m 3"]
    along: Float[np.ndarray, "m 3"]


def chart_coordinates(tube: TubeChart) -> Float[np.ndarray, "m 3 2"]:
    """Texture coordinates of each corner of each face, without overlap, in the unit square.

    The tube is cut into charts about 3 cm wide and long. Each is flattened as rigidly as possible,
    and their boxes are packed. A face belongs to the chart that contains its center.

    The texel density on the sides of folds equals that between them: a face that comes out squeezed
    is flattened again with a larger target, so that few texels are wider than the mean.
    """
    chart, circumference = _cut(tube)
    index, chart_uv = _unroll(tube, chart, circumference)
    flat = _relax_groups(_flat_faces(tube.corners), index, chart_uv, chart)
    # A chart with a mirrored face keeps its unrolled shape.
    is_mirrored = texture_stretch(tube.corners, flat[index])[:, 0] <= 0.0
    stays = np.isin(chart, chart[is_mirrored])
    flat[index[stays]] = chart_uv[index[stays]]
    owner = np.zeros(len(flat), int)
    owner[index] = chart[:, None]
    uv = _pack(flat, owner)[index]
    return np.rint(uv * _STEPS) / _STEPS


def _cut(tube: TubeChart) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Chart index of each face, without gaps, and local circumference of the tube [m]."""
    area = triangle_areas(tube.corners)
    length = tube.along.max()
    num_rows = max(1, round(length / _SIDE))
    row = np.clip(tube.along.mean(axis=1) / length * num_rows, 0, num_rows - 1).astype(int)
    circumference = np.bincount(row, area, num_rows) * num_rows / length
    num_columns = np.maximum(2, np.rint(circumference / _SIDE)).astype(int)
    column = np.clip(tube.turn.mean(axis=1) * num_columns[row], 0, num_columns[row] - 1)
    index = (np.cumsum(num_columns) - num_columns)[row] + column.astype(int)
    _, chart = np.unique(index, return_inverse=True)
    return chart, circumference[row]


def _unroll(
    tube: TubeChart, chart: Int[np.ndarray, " m"], circumference: Float[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, "m 3"], Float[np.ndarray, "k 2"]]:
    """Indices of each face into the charts' vertices, and their positions around and along [m]."""
    key = chart[:, None] * (int(tube.faces.max()) + 1) + tube.faces
    keys, index = np.unique(key, return_inverse=True)
    index = index.reshape(-1, 3)
    chart_uv = np.empty((len(keys), 2))
    chart_uv[index, 0] = tube.turn * circumference[:, None]
    chart_uv[index, 1] = tube.along
    return index, chart_uv


def _flat_faces(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3 2"]:
    """Each face laid flat in its own plane [m]."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.maximum(np.linalg.norm(first, axis=1), 1e-12)
    flat = np.zeros((len(corners), 3, 2))
    flat[:, 1, 0] = length
    flat[:, 2, 0] = (first * second).sum(axis=1) / length
    flat[:, 2, 1] = np.linalg.norm(np.cross(first, second), axis=1) / length
    return flat


def _relax_groups(
    shape: Float[np.ndarray, "m 3 2"],
    index: Int[np.ndarray, "m 3"],
    chart_uv: Float[np.ndarray, "k 2"],
    chart: Int[np.ndarray, " m"],
) -> Float[np.ndarray, "k 2"]:
    """Apply `_relax` to fixed-size groups of charts, independent of the number of threads."""
    flat = chart_uv.copy()

    def relax(faces: Int[np.ndarray, " l"]) -> None:
        used, own = np.unique(index[faces], return_inverse=True)
        own = own.reshape(-1, 3)
        flat[used] = _relax(shape[faces], own, chart_uv[used], chart[faces][:, None])

    order = np.argsort(chart, kind="stable")
    starts = np.searchsorted(chart[order], np.arange(0, chart.max() + 1, _GROUP))
    with ThreadPoolExecutor(_core.num_threads()) as threads:
        list(threads.map(relax, np.split(order, starts[1:])))
    return flat


def _relax(
    shape: Float[np.ndarray, "m 3 2"],
    index: Int[np.ndarray, "m 3"],
    chart_uv: Float[np.ndarray, "k 2"],
    chart: Int[np.ndarray, "m 1"],
) -> Float[np.ndarray, "k 2"]:
    """Flatten charts as rigidly as possible, starting from given positions.

    Alternates local and global steps: each face finds the best-fitting rotation of its shape,
    then all vertices find the positions that best fit the rotated edges (Liu, Zhang, Xu, Gotsman
    and Gortler, "A local/global approach to mesh parameterization", SGP 2008).
    """
    weight = _cotangents(shape)
    solve, pin = _factored(weight, index, len(chart_uv), chart)
    edges = _opposite_edges(shape)
    start, end = index[:, [1, 2, 0]].ravel(), index[:, [2, 0, 1]].ravel()
    for number in range(_NUM_ROUNDS):
        flat = _opposite_edges(chart_uv[index])
        if number in _GROWTH_ROUNDS:
            least = np.abs(_least_stretch(edges, flat))
            growth = np.clip(1.0 / np.maximum(least, 0.1), 1.0, _MAX_GROWTH)
            edges = edges * growth[:, None, None]
        cosine = (weight * (edges * flat).sum(axis=2)).sum(axis=1)
        sine = (weight * _cross(edges, flat)).sum(axis=1)
        norm = np.maximum(np.hypot(cosine, sine), 1e-30)
        cosine, sine = cosine / norm, sine / norm
        x, y = edges[..., 0], edges[..., 1]
        turned = np.stack(
            [
                cosine[:, None] * x - sine[:, None] * y,
                sine[:, None] * x + cosine[:, None] * y,
            ]
        )
        pull = (turned * weight).reshape(2, -1)
        sums = [
            np.bincount(end, p, len(chart_uv)) - np.bincount(start, p, len(chart_uv)) for p in pull
        ]
        chart_uv = solve(np.stack(sums, axis=1) + pin[:, None] * chart_uv)
    return chart_uv


def _factored(
    weight: Float[np.ndarray, "m 3"],
    index: Int[np.ndarray, "m 3"],
    count: int,
    chart: Int[np.ndarray, "m 1"],
):
    """Solver of the charts' Laplacian with one vertex fixed per chart, and the fixing weights."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import splu

    start, end = index[:, [1, 2, 0]].ravel(), index[:, [2, 0, 1]].ravel()
    pin = np.zeros(count)
    _, first = np.unique(np.broadcast_to(chart, index.shape), return_index=True)
    pin[index.ravel()[first]] = 1.0
    w, every = weight.ravel(), np.arange(count)
    values = np.concatenate([-w, -w, w, w, pin])
    rows = np.concatenate([start, end, start, end, every])
    columns = np.concatenate([end, start, start, end, every])
    matrix = coo_array((values, (rows, columns)), shape=(count, count)).tocsc()
    options = {"SymmetricMode": True}
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return factors.solve, pin


def _opposite_edges(shape: Float[np.ndarray, "m 3 2"]) -> Float[np.ndarray, "m 3 2"]:
    """Edge opposite to each corner, around the face."""
    return shape[:, [2, 0, 1]] - shape[:, [1, 2, 0]]


def _cross(a: Float[np.ndarray, "*shape 2"], b: Float[np.ndarray, "*shape 2"]) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _cotangents(shape: Float[np.ndarray, "m 3 2"]) -> Float[np.ndarray, "m 3"]:
    """Half the cotangent of the angle at each corner; kept positive at flat angles."""
    to_next, to_last = np.roll(shape, -1, axis=1) - shape, np.roll(shape, 1, axis=1) - shape
    area = np.maximum(_cross(to_next, to_last), 1e-14)
    return 0.5 * np.clip((to_next * to_last).sum(axis=2) / area, 0.02, 20.0)


def _least_stretch(
    edges: Float[np.ndarray, "m 3 2"], flat: Float[np.ndarray, "m 3 2"]
) -> Float[np.ndarray, " m"]:
    """Smaller singular value of each face's map from target edges to actual edges."""
    solid = np.zeros((len(edges), 3, 3))
    solid[..., :2] = np.cumsum(edges, axis=1)
    return texture_stretch(solid, np.cumsum(flat, axis=1))[:, 0]


def _pack(
    chart_uv: Float[np.ndarray, "k 2"], chart: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k 2"]:
    """Rotate charts into small boxes and pack them on shelves in the unit square."""
    num = int(chart.max()) + 1
    order = np.argsort(chart, kind="stable")
    first = np.searchsorted(chart[order], np.arange(num))
    turned, box = chart_uv.copy(), np.full((num, 2), np.inf)
    for angle in _ANGLES:
        c, s = np.cos(angle), np.sin(angle)
        trial = np.stack(
            [c * chart_uv[:, 0] - s * chart_uv[:, 1], s * chart_uv[:, 0] + c * chart_uv[:, 1]], 1
        )
        low = np.minimum.reduceat(trial[order], first)
        size = np.maximum.reduceat(trial[order], first) - low + GAP
        is_better = size.prod(axis=1) < box.prod(axis=1)
        box[is_better] = size[is_better]
        moves = is_better[chart]
        turned[moves] = (trial - low[chart])[moves]
    side = np.sqrt(box.prod(axis=1).sum())
    layouts = [_shelves(box, side * stretch) for stretch in np.linspace(0.95, 1.1, 7)]
    corner, size = min(layouts, key=lambda layout: layout[1].prod())
    return (turned + corner[chart] + 0.5 * GAP) / size


def _shelves(
    box: Float[np.ndarray, "n 2"], width: float
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " 2"]]:
    """Lower left corner of each box, tall ones first, and the size that contains them all."""
    width = max(width, float(box[:, 0].max()))
    corner = np.zeros_like(box)
    x = y = height = 0.0
    for k in np.argsort(-box[:, 1], kind="stable"):
        if x + box[k, 0] > width:
            x, y, height = 0.0, y + height, 0.0
        corner[k] = x, y
        x += box[k, 0]
        height = max(height, box[k, 1])
    return corner, np.array([width, y + height])
