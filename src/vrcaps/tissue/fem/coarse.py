"""Coarse surface of curved triangles that approximates a fine surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.rng import stream
from vrcaps.mesh.mesh import wall_of
from vrcaps.tissue.fem.curved import BentTriangles, bulges_towards, edges_of, relaxed
from vrcaps.tissue.fem.layer import CoarseSurface
from vrcaps.tissue.fem.smooth import border_edges, low_pass

if TYPE_CHECKING:
    from jaxtyping import Float, Int

# Undulations shorter than this many edges are left out of the layer's shape and follow its motion.
_WAVELENGTH_EDGES = 3.0
# Seeds in random order with at least this distance reach the density of equilateral triangles
# of edge 1 (random sequential packing covers 0.55 of the plane, hexagonal packing 0.91).
_SEED_DISTANCE = 0.8
_ROUNDS = 12
_ATTEMPTS = 4


@dataclass(frozen=True)
class Coarsened:
    """A coarse surface and the mapping of the fine surface onto it.

    Attributes:
        surface: Curved triangles.
        smooth: Vertices of the fine surface without short undulations [m].
        cell: Corner of the coarse surface that each fine vertex belongs to.
        nearest: Fine vertex nearest to each node of the coarse surface.
        border: Nodes of the coarse surface on open ends.
    """

    surface: CoarseSurface
    smooth: Float[np.ndarray, "n 3"]
    cell: Int[np.ndarray, " n"]
    nearest: Int[np.ndarray, " nodes"]
    border: Int[np.ndarray, " k"]


def coarsen(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    edge: float,
    thickness: float,
) -> Coarsened:
    """Approximate the broad shape of a fine surface by triangles with edges of about `edge` [m].

    The fine surface is divided into cells around evenly spread seeds (Lloyd iterations by distance
    along the surface); the dual of the cells gives the triangles (Valette, Chassery, Comput. Graph.
    Forum 23(3):381-389, 2004). Triangles whose outward layer of `thickness` [m] would fold are
    evened out.

    Raises:
        InputError: If edges are too long for the triangles to follow the surface.
    """
    smooth = low_pass(vertices, faces, _WAVELENGTH_EDGES * edge)
    graph = _edge_graph(smooth, faces)
    border = np.unique(border_edges(faces))
    rng = stream(0, "fem/coarse-surface")
    for _ in range(_ATTEMPTS):
        seeds, cell = _cells(smooth, graph, border, edge, rng)
        triangles = _dual(cell, faces)
        if _is_like(triangles, len(seeds), faces, len(vertices)):
            break
    else:
        raise InputError(
            f"edge is {1e3 * edge:g} mm, too long for this organ: its tubes need five edges "
            "around them, and its pieces more. Give a smaller edge."
        )
    bent, border = _bent(smooth, faces, seeds, triangles)
    surface = relaxed(bent, thickness).surface
    nearest = np.asarray(scipy.spatial.KDTree(smooth).query(surface.nodes)[1])
    return Coarsened(surface, smooth, cell, nearest, border)


def _edge_graph(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> scipy.sparse.csr_matrix:
    pairs = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    ends = (np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]]))
    # A sparse matrix would drop an edge of zero length.
    length = np.maximum(np.tile(length, 2), 1e-9)
    return scipy.sparse.csr_matrix((length, ends), shape=(len(vertices), len(vertices)))


def _cells(
    vertices: Float[np.ndarray, "n 3"],
    graph: scipy.sparse.csr_matrix,
    border: Int[np.ndarray, " k"],
    edge: float,
    rng: np.random.Generator,
) -> tuple[Int[np.ndarray, " seeds"], Int[np.ndarray, " n"]]:
    """Evenly spread seeds, and the index of the nearest seed of each vertex."""
    count = len(vertices)
    seeds, distance = [], np.full(count, np.inf)
    # Border vertices come first, so that the triangles follow the border.
    order = np.concatenate([rng.permutation(border), rng.permutation(count)])
    for v in order:
        if distance[v] > _SEED_DISTANCE * edge:
            seeds.append(v)
            near = scipy.sparse.csgraph.dijkstra(graph, indices=v, limit=edge)
            distance = np.minimum(distance, near)
    seeds = np.array(seeds)
    on_border = np.zeros(count, bool)
    on_border[border] = True
    for _ in range(_ROUNDS):
        cell = _nearest_seed(graph, seeds)
        seeds = _centers(vertices, cell, on_border, len(seeds))
    return seeds, _nearest_seed(graph, seeds)


def _nearest_seed(
    graph: scipy.sparse.csr_matrix, seeds: Int[np.ndarray, " seeds"]
) -> Int[np.ndarray, " n"]:
    distance, _, source = scipy.sparse.csgraph.dijkstra(
        graph, indices=seeds, min_only=True, return_predecessors=True
    )
    number = np.full(len(distance) + 1, -1)
    number[seeds] = np.arange(len(seeds))
    return number[source]


def _centers(
    vertices: Float[np.ndarray, "n 3"],
    cell: Int[np.ndarray, " n"],
    on_border: np.ndarray,
    count: int,
) -> Int[np.ndarray, " seeds"]:
    """Vertex nearest to the center of each cell, or of its part on the border if it has one."""
    has_border = np.bincount(cell, on_border, count) > 0.0
    counts = (on_border | ~has_border[cell]).astype(float)
    total = np.bincount(cell, counts, count)
    middle = np.stack(
        [np.bincount(cell, counts * vertices[:, k], count) / total for k in range(3)], axis=1
    )
    away = np.linalg.norm(vertices - middle[cell], axis=1)
    away[counts == 0.0] = np.inf
    order = np.lexsort([np.arange(len(cell)), away, cell])
    return order[np.searchsorted(cell[order], np.arange(count))]


def _dual(cell: Int[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "k 3"]:
    """Triangles between adjacent cells; triangles of opposite orientation cancel."""
    met = cell[faces]
    met = met[(met[:, 0] != met[:, 1]) & (met[:, 1] != met[:, 2]) & (met[:, 2] != met[:, 0])]
    first = np.argmin(met, axis=1)
    met = np.take_along_axis(met, (first[:, None] + np.arange(3)) % 3, axis=1)
    met, times = np.unique(met, axis=0, return_counts=True)
    back, place = np.unique(met[:, [0, 2, 1]], axis=0, return_index=True)
    both, here, there = np.intersect1d(_keys(met), _keys(back), return_indices=True)
    times[here] -= np.minimum(times[here], times[place[there]]) if len(both) else 0
    return met[times > 0]


def _keys(triangles: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, " k"]:
    size = int(triangles.max(initial=0)) + 1
    return (triangles[:, 0] * size + triangles[:, 1]) * size + triangles[:, 2]


def _is_like(
    triangles: Int[np.ndarray, "k 3"], num_seeds: int, faces: Int[np.ndarray, "m 3"], count: int
) -> bool:
    """Check that the triangles are a manifold with the topology of the fine surface."""
    if len(triangles) < 4:
        return False
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    if len(np.unique(edges, axis=0)) < len(edges) or len(np.unique(triangles)) < num_seeds:
        return False
    border = border_edges(triangles)
    simple = len(np.unique(border[:, 0])) == len(border)
    num_edges = (len(edges) + len(border)) // 2
    characteristic = num_seeds - num_edges + len(triangles)
    fine_edges = (3 * len(faces) + len(border_edges(faces))) // 2
    return simple and characteristic == count - fine_edges + len(faces)


def _bent(
    smooth: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    seeds: Int[np.ndarray, " seeds"],
    triangles: Int[np.ndarray, "k 3"],
) -> tuple[BentTriangles, Int[np.ndarray, " border"]]:
    """Bend the edges so that their midpoints lie on the surface; also return the border nodes."""
    pairs, triangles = edges_of(triangles)
    corners, size = smooth[seeds], len(seeds)
    straight = corners[pairs].mean(axis=1)
    wall = wall_of(smooth, faces)
    middle, _ = wall.closest_point(straight)
    coarse_border = np.sort(border_edges(triangles[:, :3]), axis=1)
    is_open = np.isin(pairs @ [size, 1], coarse_border @ [size, 1])
    if is_open.any():
        rim = smooth[np.unique(border_edges(faces))]
        middle[is_open] = rim[scipy.spatial.KDTree(rim).query(straight[is_open])[1]]
    bent = BentTriangles(corners, pairs, bulges_towards(corners, pairs, middle), triangles)
    return bent, np.concatenate([np.unique(coarse_border), size + np.flatnonzero(is_open)])
