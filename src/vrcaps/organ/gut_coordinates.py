"""Gut coordinates of a wall: arc length along its centerline and angle around it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.geometry import edge_graph
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.surface import Centerline, interpolate

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_SEED_DISTANCE = 1.3  # local radii from the curve within which wall certainly belongs to it
_SEED_FACING = 0.3  # cosine between the wall's normal and the direction to the curve
_STEEPEST = 4.0  # accepted maximum change of arc length along an edge, in edge lengths
_PULL = 1e-3  # weight of a loose vertex's own foot relative to its ring
_WINDOW = 24  # curve samples on either side in which a vertex's foot is searched


def gut_coordinates(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], centerline: Centerline
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Arc length [m], angle [rad] and distance [m] of each wall vertex from the centerline.

    The nearest point of the curve may belong to a neighboring loop of gut. Therefore only wall
    that is close to the curve and faces it is assigned its nearest point. From there assignments
    spread over the wall, with each vertex searching for its foot near those of its neighbors.
    Where feet still jump (across a sharp bend), arc length is filled in harmonically: it is
    continuous.

    Args:
        vertices: Vertices of the wall [m].
        faces: Counter-clockwise as seen from the lumen.
        centerline: In the same frame.

    Returns:
        `arc_length` in [0, length], `theta` in (−π, π] from the first to the second
        transverse axis of the centerline's frame, `radius`.
    """
    vertices = np.asarray(vertices, float)
    graph = edge_graph(vertices, faces)
    foot = _spread(vertices, graph, centerline, _seeds(vertices, faces, graph, centerline))
    arc_length = _refine(vertices, centerline, foot)
    arc_length = _fill_jumps(arc_length, graph)
    points, frames, _ = interpolate(centerline, arc_length)
    offset = vertices - points
    x, y, _ = np.einsum("nij,ni->jn", frames, offset)
    theta = np.arctan2(y, x)
    return arc_length, np.where(theta <= -np.pi, np.pi, theta), np.linalg.norm(offset, axis=1)


def _seeds(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    graph: scipy.sparse.coo_array,
    centerline: Centerline,
) -> Int[np.ndarray, " n"]:
    """Nearest curve sample where it certainly belongs to the vertex, −1 elsewhere.

    A connected piece of wall without such a vertex is assigned its nearest samples.
    """
    distance, nearest = scipy.spatial.KDTree(centerline.points).query(vertices)
    towards = centerline.points[nearest] - vertices
    facing = (towards * vertex_normals(vertices, faces)).sum(axis=1) > _SEED_FACING * distance
    sure = facing & (distance < _SEED_DISTANCE * centerline.radius[nearest])
    patch = _patches(centerline.arc_length[nearest], graph, sure, centerline.length)
    size = np.bincount(patch, weights=sure)
    _, piece = scipy.sparse.csgraph.connected_components(graph, directed=False)
    largest = np.zeros(piece.max() + 1)
    np.maximum.at(largest, piece, size[patch])
    sure &= size[patch] >= np.minimum(largest[piece], max(3.0, 0.002 * len(vertices)))
    seeded = np.bincount(piece, weights=sure) > 0
    return np.where(sure | ~seeded[piece], nearest, -1)


def _patches(
    arc_length: Float[np.ndarray, " n"],
    graph: scipy.sparse.coo_array,
    member: Bool[np.ndarray, " n"],
    length: float,
) -> Int[np.ndarray, " n"]:
    """Patch index of each vertex: members joined by edges along which feet agree."""
    row, column = graph.coords
    agree = np.abs(arc_length[row] - arc_length[column]) < _STEEPEST * graph.data + 0.002 * length
    keep = agree & member[row] & member[column]
    joined = scipy.sparse.coo_array(
        (np.ones(keep.sum()), (row[keep], column[keep])), shape=graph.shape
    )
    return scipy.sparse.csgraph.connected_components(joined, directed=False)[1]


def _spread(
    vertices: Float[np.ndarray, "n 3"],
    graph: scipy.sparse.coo_array,
    centerline: Centerline,
    foot: Int[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:
    """Nearest sample of each vertex among those near its neighbors' feet, ring by ring."""
    row, column = graph.coords
    step = centerline.length / (len(centerline.points) - 1)
    foot = foot.copy()
    last = len(centerline.points) - 1
    offsets = np.arange(-_WINDOW, _WINDOW + 1)
    while True:
        rim = (foot[row] < 0) & (foot[column] >= 0)
        if not rim.any():
            return foot
        count = np.bincount(row[rim], minlength=len(foot))
        ids = np.flatnonzero(count)
        expected = np.bincount(row[rim], foot[column[rim]], len(foot))[ids] / count[ids]
        reach = np.bincount(row[rim], graph.data[rim], len(foot))[ids] / count[ids]
        reach = np.maximum(_STEEPEST / 2 * reach / step, 1.0)
        candidates = np.rint(expected).astype(int)[:, None] + offsets
        distance = np.linalg.norm(
            centerline.points[np.clip(candidates, 0, last)] - vertices[ids, None], axis=2
        )
        distance[(np.abs(offsets) > reach[:, None]) | (candidates < 0) | (candidates > last)] = (
            np.inf
        )
        foot[ids] = candidates[np.arange(len(ids)), np.argmin(distance, axis=1)]


def _refine(
    vertices: Float[np.ndarray, "n 3"], centerline: Centerline, foot: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Arc length at which the curve's normal plane contains the vertex, near its nearest sample.

    Between samples, the signed distance to the plane is linear to second order in their step.
    """
    last = len(centerline.points) - 1

    def ahead(sample: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        offset = vertices - centerline.points[sample]
        return (offset * centerline.frames[sample, :, 2]).sum(axis=1)

    below = np.clip(np.where(ahead(foot) >= 0.0, foot, foot - 1), 0, last - 1)
    before, behind = ahead(below), ahead(below + 1)
    fall = before - behind
    t = np.clip(before / np.where(fall > 0.0, fall, np.inf), 0.0, 1.0)
    knots = centerline.arc_length
    return knots[below] + t * (knots[below + 1] - knots[below])


def _fill_jumps(
    arc_length: Float[np.ndarray, " n"], graph: scipy.sparse.coo_array
) -> Float[np.ndarray, " n"]:
    """Arc length with vertices at and next to jumps replaced by the mean of their ring.

    A weak regularization towards the previous values keeps this solvable where a component of the
    wall is not connected to the rest.
    """
    row, column = graph.coords
    jump = np.abs(arc_length[row] - arc_length[column]) > _STEEPEST * graph.data
    loose = np.zeros(len(arc_length), bool)
    loose[row[jump]] = True
    loose[row[loose[column]]] = True
    ids = np.flatnonzero(loose)
    if not len(ids):
        return arc_length
    shortest = graph.data[graph.data > 0.0].min(initial=np.inf)
    weights = scipy.sparse.csr_array(
        (1.0 / np.maximum(graph.data, shortest), (row, column)), graph.shape
    )
    rows = weights[ids]
    total = rows.sum(axis=1)
    system = scipy.sparse.diags_array((1.0 + _PULL) * total) - rows[:, ids]
    known = rows[:, np.flatnonzero(~loose)] @ arc_length[~loose] + _PULL * total * arc_length[ids]
    filled = arc_length.copy()
    filled[ids] = scipy.sparse.linalg.spsolve(system.tocsc(), known)
    return filled
