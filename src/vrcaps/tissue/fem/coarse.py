"""Coarse surface of curved triangles that approximates a fine surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas, wall_of
from vrcaps.core.rng import stream
from vrcaps.tissue.fem.layer import EDGES, CoarseSurface, shapes, thinnest

if TYPE_CHECKING:
    from jaxtyping import Float, Int


# The cotangent of a needle triangle would tie its corners together.
_MAX_COTANGENT = 20.0


def low_pass(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], wavelength: float
) -> Float[np.ndarray, "n 3"]:
    """Positions without undulations shorter than a wavelength [m].

    Minimizes ∫|x − x₀|² + τ² |Δx|² dA with τ = (wavelength/2π)², then filters the residual in the
    same way and adds it back (twicing: Tukey, Exploratory Data Analysis, 1977, 16). An undulation
    of length d is scaled by 1 − s² with s = 1/(1 + (d/wavelength)⁴), so that a wide tube keeps
    its radius. Flat regions are unchanged up to an open border. Δ is the cotangent Laplacian
    (Pinkall, Polthier, Exp. Math. 2(1):15-36, 1993).
    """
    area, stiffness = cotangent_laplacian(vertices, faces)
    inner = np.ones(len(vertices))
    inner[border_edges(faces).ravel()] = 0.0
    bending = stiffness @ scipy.sparse.diags(inner / area) @ stiffness
    tau = (0.5 * wavelength / np.pi) ** 2
    matrix = (scipy.sparse.diags(area) + tau**2 * bending).tocsc()
    options = {"SymmetricMode": True}
    solver = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
    )
    center = vertices.mean(axis=0)
    around = vertices - center
    once = solver.solve(area[:, None] * around)
    return once + solver.solve(area[:, None] * (around - once)) + center


def cotangent_laplacian(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, " n"], scipy.sparse.csr_matrix]:
    """Area of each vertex [m²], and the cotangent stiffness matrix, positive semidefinite."""
    corners, count = vertices[faces], len(vertices)
    double_area = 2.0 * triangle_areas(corners)
    tiny = 1e-12 * double_area.mean()
    area = np.bincount(faces.ravel(), np.repeat(double_area / 6.0, 3), count)
    matrix = scipy.sparse.csr_matrix((count, count))
    for k in range(3):
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        cotangent = (a * b).sum(1) / np.maximum(double_area, tiny)
        half = 0.5 * np.clip(cotangent, -_MAX_COTANGENT, _MAX_COTANGENT)
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        ends = (np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j]))
        matrix += scipy.sparse.csr_matrix(
            (np.concatenate([-half, -half, half, half]), ends), shape=(count, count)
        )
    return np.maximum(area, tiny), matrix


def border_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "k 2"]:
    """Directed edges that belong to only one face."""
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    count = int(faces.max()) + 1
    forth, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    return edges[~np.isin(forth, back)]


# The midpoint of an edge bulges by at most this fraction of its length, as on an arc of 80 degrees.
_MAX_BULGE = 0.18
_ROUNDS = 60
# Number of rounds that move the corners of bad triangles only; then one more ring is added, etc.
_ROUNDS_BY_RING = 15
# An element is bad if its volume shrinks anywhere to this fraction of its mean.
_THIN = 0.1
_RELAXATION = 0.25


@dataclass(frozen=True)
class BentTriangles:
    """Triangles whose edge midpoints may lie off the straight edges.

    Attributes:
        corners: Positions [m].
        pairs: Corners of each edge.
        bulges: Offset from the midpoint of the straight edge to that of the bent edge [m].
        triangles: Corners of each triangle, then the indices of its edges 01, 12, 02.
    """

    corners: Float[np.ndarray, "c 3"]
    pairs: Int[np.ndarray, "e 2"]
    bulges: Float[np.ndarray, "e 3"]
    triangles: Int[np.ndarray, "m 6"]

    @property
    def surface(self) -> CoarseSurface:
        """The triangles with nodes at the edge midpoints and outward directions."""
        nodes = np.concatenate([self.corners, _middles(self.corners, self.pairs) + self.bulges])
        index = self.triangles + len(self.corners) * (np.arange(6) >= 3)
        return CoarseSurface(nodes, _outward(nodes, index), index)


def edges_of(triangles: Int[np.ndarray, "m 3"]) -> tuple[np.ndarray, Int[np.ndarray, "m 6"]]:
    """Corners of all edges, and the triangles with the indices of their edges 01, 12, 02."""
    sides = np.stack([np.sort(triangles[:, list(pair)], axis=1) for pair in EDGES[:3]], axis=1)
    pairs, side = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    return pairs, np.concatenate([triangles, side.reshape(-1, 3)], axis=1)


def bulges_towards(
    corners: Float[np.ndarray, "c 3"],
    pairs: Int[np.ndarray, "e 2"],
    middle: Float[np.ndarray, "e 3"],
) -> Float[np.ndarray, "e 3"]:
    """Bulges perpendicular to the edges that move their midpoints towards given points."""
    chord = corners[pairs[:, 1]] - corners[pairs[:, 0]]
    length = np.linalg.norm(chord, axis=1, keepdims=True)
    bulge = middle - _middles(corners, pairs)
    bulge -= (bulge * chord).sum(1, keepdims=True) / length**2 * chord
    size = np.linalg.norm(bulge, axis=1, keepdims=True)
    return bulge * np.minimum(1.0, _MAX_BULGE * length / np.maximum(size, 1e-12))


def relaxed(bent: BentTriangles, thickness: float) -> BentTriangles:
    """Straighten and even out triangles whose layer would fold, as far as possible."""
    first, last = bent.pairs.T
    degree = np.bincount(bent.pairs.ravel(), minlength=len(bent.corners))
    for number in range(_ROUNDS):
        bad = thinnest(bent.surface, thickness) < _THIN
        if not bad.any():
            break
        for _ in range(number // _ROUNDS_BY_RING):
            bad = np.isin(bent.triangles[:, :3], bent.triangles[bad, :3]).any(axis=1)
        total = np.zeros_like(bent.corners)
        np.add.at(total, first, bent.corners[last])
        np.add.at(total, last, bent.corners[first])
        corners, bulges = bent.corners.copy(), bent.bulges.copy()
        move = np.unique(bent.triangles[bad, :3])
        corners[move] += _RELAXATION * (total[move] / degree[move, None] - corners[move])
        bulges[np.unique(bent.triangles[bad, 3:])] *= 1.0 - _RELAXATION
        bent = replace(bent, corners=corners, bulges=bulges)
    return bent


def _middles(
    corners: Float[np.ndarray, "c 3"], pairs: Int[np.ndarray, "e 2"]
) -> Float[np.ndarray, "e 3"]:
    return corners[pairs].mean(axis=1)


def _outward(
    nodes: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 6"]
) -> Float[np.ndarray, "n 3"]:
    """Unit directions away from the lumen: area-weighted means over the adjacent triangles."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    barycentric_nodes = np.concatenate(
        [corners, [(corners[a] + corners[b]) / 2.0 for a, b in EDGES[:3]]]
    )
    tangents = np.einsum("eai,qaj->eqji", nodes[triangles], shapes(barycentric_nodes)[1])
    inward = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    total = np.stack(
        [np.bincount(triangles.ravel(), inward[..., k].ravel(), len(nodes)) for k in range(3)], 1
    )
    return -total / np.linalg.norm(total, axis=1, keepdims=True)


# Undulations shorter than this many edges are left out of the layer's shape and follow its motion.
_WAVELENGTH_EDGES = 3.0
# Seeds in random order with at least this distance reach the density of equilateral triangles
# of edge 1 (random sequential packing covers 0.55 of the plane, hexagonal packing 0.91).
_SEED_DISTANCE = 0.8
_LLOYD_ROUNDS = 12
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
            f"edge is {1e3 * edge:g} mm: too long for this organ. Its tubes need five edges "
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
    for _ in range(_LLOYD_ROUNDS):
        cell = _nearest_seed(graph, seeds)
        seeds = _centers(vertices, cell, on_border, len(seeds))
    return seeds, _nearest_seed(graph, seeds)


def _nearest_seed(
    graph: scipy.sparse.csr_matrix, seeds: Int[np.ndarray, " seeds"]
) -> Int[np.ndarray, " n"]:
    distance, _, source = scipy.sparse.csgraph.dijkstra(
        graph, indices=seeds, min_only=True, return_predecessors=True
    )
    index = np.full(len(distance) + 1, -1)
    index[seeds] = np.arange(len(seeds))
    return index[source]


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
    back, index = np.unique(met[:, [0, 2, 1]], axis=0, return_index=True)
    both, here, there = np.intersect1d(_keys(met), _keys(back), return_indices=True)
    times[here] -= np.minimum(times[here], times[index[there]]) if len(both) else 0
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
