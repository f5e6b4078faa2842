"""Non-manifold edges and vertices, and face orientation."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.mesh.mesh import (
    Edges,
    Mesh,
    face_areas,
    find_edges,
    flip_faces,
    keep_faces,
    split_face,
    take_vertices,
)
from vrcaps.mesh.repair.repair_report import Repair, format_point

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_FIN_AREA = 0.01  # of the whole; an open patch smaller than this is a fin, not wall
_NUDGE = 1e-3  # fraction of the way to a vertex's neighbors; separates cut sheets
_MAX_PASSES = 10
_MAX_WORK = 300_000  # of pairing the faces of nonmanifold edges, in steps of some 20 µs


def split_nonmanifold(mesh: Mesh) -> tuple[Mesh, Int[np.ndarray, " n"], list[Repair]]:
    """Split the surface where more than two sheets meet (Guéziec et al. 2001).

    At an edge of more than two faces those that best continue each other stay joined; a
    vertex is duplicated for every fan of faces that remains connected around it.

    Returns:
        The mesh, the old index of each of its vertices, and the repairs.
    """
    edges = find_edges(mesh.faces)
    on_edge = edges.ends[[int(halves[0]) for halves in edges.nonmanifold()] or np.zeros(0, int)]
    repairs = []
    if len(on_edge):
        middles = mesh.vertices[on_edge].mean(axis=1)
        repairs.append(Repair("non-manifold edge", len(on_edge), "cut apart", middles))
    cut, origin, partner = _cut(mesh)
    for _ in range(_MAX_PASSES):
        double = find_edges(cut.faces).nonmanifold()
        if not double:
            break
        mesh = _bisect_double_edges(mesh, double, partner)
        cut, origin, partner = _cut(mesh)
    values, counts = np.unique(origin, return_counts=True)
    lone = np.setdiff1d(values[counts > 1], on_edge)
    if len(lone):
        positions = mesh.vertices[lone]
        repairs.append(Repair("non-manifold vertex", len(lone), "cut apart", positions))
    return cut, origin, repairs


def _cut(mesh: Mesh) -> tuple[Mesh, Int[np.ndarray, " n"], dict[int, int]]:
    """Mesh with a vertex for each fan of joined faces, their old indices, and joined half-edges."""
    edges = find_edges(mesh.faces)
    joined, partner = edges.with_count(2), {}
    nonmanifold = edges.nonmanifold()
    if nonmanifold:
        is_fin = _is_fin(mesh, edges)
        fan = _join_corners(edges.ends, joined)
        pairs = _pair_faces(mesh, nonmanifold, is_fin, fan)
        partner = {int(a): int(b) for a, b in np.concatenate([pairs, pairs[:, ::-1]])}
        joined = np.concatenate([joined, pairs])
    _, first, index = np.unique(
        _join_corners(edges.ends, joined), return_index=True, return_inverse=True
    )
    origin = mesh.faces.reshape(-1)[first]
    order = np.argsort(origin, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    origin = origin[order]
    return take_vertices(mesh, origin, rank[index].reshape(-1, 3)), origin, partner


def _bisect_double_edges(
    mesh: Mesh, double: list[Int[np.ndarray, " k"]], partner: dict[int, int]
) -> Mesh:
    """Insert a middle vertex in all but one of the pairs of faces that share both ends of an edge.

    Pairs that touch a face that is already split wait for the next pass.
    """
    keep = np.ones(len(mesh.faces), bool)
    vertices, sources, faces, uvs = [], [], [], []
    for halves in double:
        pairs = [(h, partner[h]) for h in halves.tolist() if h < partner.get(h, -1)]
        for pair in pairs[1:]:
            if not keep[[half // 3 for half in pair]].all():
                continue
            middle = len(mesh.vertices) + len(vertices)
            ends = _edge_ends(mesh, pair[0])
            apexes = [mesh.faces[half // 3, (half % 3 + 2) % 3] for half in pair]
            inward = mesh.vertices[apexes].mean(axis=0) - ends.mean(axis=0)
            vertices.append(ends.mean(axis=0) + _NUDGE * inward)
            sources.append(mesh.faces[pair[0] // 3, pair[0] % 3])
            for half in pair:
                keep[half // 3] = False
                new_faces, new_uvs = split_face(mesh, half // 3, half % 3, (middle, 0.5))
                faces.append(new_faces)
                uvs.append(new_uvs)
    kept = keep_faces(mesh, keep)
    return Mesh(
        np.concatenate([mesh.vertices, np.array(vertices).reshape(-1, 3)]),
        np.concatenate([kept.faces, *faces]),
        None if kept.uv is None else np.concatenate([kept.uv, *uvs]),
        None if mesh.label is None else np.append(mesh.label, mesh.label[sources]),
    )


def _edge_ends(mesh: Mesh, half: int) -> Float[np.ndarray, "2 3"]:
    """Positions of the ends of a half-edge [m]."""
    face, side = divmod(int(half), 3)
    return mesh.vertices[mesh.faces[face, [side, (side + 1) % 3]]]


def separate_copies(mesh: Mesh, origin: Int[np.ndarray, " n"]) -> Mesh:
    """Move duplicated vertices 0.1 % towards their own neighbors."""
    _, number, counts = np.unique(origin, return_inverse=True, return_counts=True)
    copies = counts[number] > 1
    if not copies.any():
        return mesh
    ends = find_edges(mesh.faces).ends
    both = np.concatenate([ends, ends[:, ::-1]])
    size = len(mesh.vertices)
    degree = np.bincount(both[:, 0], minlength=size)
    sums = [np.bincount(both[:, 0], mesh.vertices[both[:, 1], axis], size) for axis in range(3)]
    mean = np.stack(sums, axis=1) / np.maximum(degree, 1)[:, None]
    step = np.where(copies[:, None], _NUDGE * (mean - mesh.vertices), 0.0)
    return replace(mesh, vertices=mesh.vertices + step)


def orient_consistently(mesh: Mesh) -> tuple[Mesh, list[Repair]]:
    """Orient all faces of a connected manifold consistently, flipping as few as possible.

    Each face has two nodes in a graph, original and flipped; neighbors that agree connect
    equal states, the others opposite ones. If both nodes of a face are in one component,
    the surface is one-sided.

    Raises:
        InputError: If the surface is not orientable.
    """
    edges = find_edges(mesh.faces)
    pairs = edges.with_count(2)
    left, right = pairs.T // 3
    disagrees = edges.ends[pairs[:, 0], 0] == edges.ends[pairs[:, 1], 0]
    size = len(mesh.faces)
    partner = right + size * disagrees
    rows = np.concatenate([left, left + size])
    columns = np.concatenate([partner, (partner + size) % (2 * size)])
    graph = scipy.sparse.coo_matrix(
        (np.ones(len(rows), bool), (rows, columns)), (2 * size, 2 * size)
    )
    side = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    if side[0] == side[size]:
        position = _conflict_position(mesh, edges, disagrees)
        raise InputError(
            f"The surface has only one side (like a Möbius strip) near {position}. "
            "Cut it there, or export a surface with an inside."
        )
    is_flipped = side[:size] != side[0]
    if 2 * is_flipped.sum() > size:
        is_flipped = ~is_flipped
    count = int(is_flipped.sum())
    if count == 0:
        return mesh, []
    positions = mesh.vertices[mesh.faces[is_flipped]].mean(axis=1)
    repair = Repair("flipped triangle", count, "turned to agree with its neighbors", positions)
    return flip_faces(mesh, is_flipped), [repair]


def _is_fin(mesh: Mesh, edges: Edges) -> Bool[np.ndarray, " m"]:
    """Faces of small patches with a free border; patches are bounded by nonmanifold edges."""
    pairs = edges.with_count(2) // 3
    size = len(mesh.faces)
    graph = scipy.sparse.coo_matrix(
        (np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (size, size)
    )
    num_patches, patch = scipy.sparse.csgraph.connected_components(graph, directed=False)
    areas = np.bincount(patch, face_areas(mesh), num_patches)
    is_open = np.zeros(num_patches, bool)
    is_open[patch[edges.with_count(1)[:, 0] // 3]] = True
    return (is_open & (areas < _FIN_AREA * areas.sum()))[patch]


def _pair_faces(
    mesh: Mesh,
    nonmanifold: list[Int[np.ndarray, " k"]],
    is_fin: Bool[np.ndarray, " m"],
    fan: Int[np.ndarray, " h"],
) -> Int[np.ndarray, "j 2"]:
    """Pairs of half-edges of nonmanifold edges that stay joined.

    Where sheets touch along a run of edges, the pairs at its ends are known from the fans of
    faces around them (`fan` of each corner); from there the choice propagates along the run.

    Raises:
        InputError: If there are too many to separate within minutes.
    """
    fans, pairs, is_stuck, work = _Fans(fan), [], False, 0
    # Edges with the corners at their ends, and their fans at the last undecided attempt.
    waiting = [(halves, _end_corners(mesh, halves), b"") for halves in nonmanifold]
    while waiting:
        later = []
        for halves, corners, before in waiting:
            around = fans.of(corners).tobytes()
            is_same = around == before and not is_stuck
            work += 1 if is_same else 10 + (len(halves) // 3) ** 2
            if work > _MAX_WORK:
                raise InputError(
                    f"{len(nonmanifold)} edges join more than two triangles: too many to separate. "
                    "Remove duplicate and stray triangles, or make a new mesh of the surface."
                )
            if is_same:
                later.append((halves, corners, before))
                continue
            best, num_shared = _best_pairs(mesh, halves, is_fin, fans)
            if num_shared == 0 and not is_stuck:
                later.append((halves, corners, around))
                continue
            is_stuck = False  # one choice without support of a fan is enough to continue
            pairs.append(best)
            for one, other in _end_corners(mesh, best).transpose(0, 2, 1).reshape(-1, 2):
                fans.join(one, other)
        is_stuck = len(later) == len(waiting)
        waiting = later
    return np.concatenate(pairs)


class _Fans:
    """Fan of faces of each corner (union-find)."""

    def __init__(self, fan: Int[np.ndarray, " h"]) -> None:
        self._fan = fan
        self._joined: dict[int, int] = {}

    def of(self, corners: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
        """Fan index of each corner."""
        roots = [self._root(fan) for fan in self._fan[corners].ravel().tolist()]
        return np.array(roots).reshape(corners.shape)

    def join(self, one: int, other: int) -> None:
        """Merge the fans of two corners."""
        root, merged = self._root(int(self._fan[one])), self._root(int(self._fan[other]))
        if root != merged:
            self._joined[merged] = root

    def _root(self, fan: int) -> int:
        path = []
        while fan in self._joined:
            path.append(fan)
            fan = self._joined[fan]
        self._joined.update(dict.fromkeys(path, fan))
        return fan


def _best_pairs(
    mesh: Mesh,
    halves: Int[np.ndarray, " k"],
    is_fin: Bool[np.ndarray, " m"],
    fans: _Fans,
) -> tuple[Int[np.ndarray, "j 2"], int]:
    """Pairs of half-edges of one nonmanifold edge, and the number of their ends with a common fan.

    Sheets must not cross, so only neighbors in the order around the edge are joined; among
    these pairings, the one that joins most faces already connected around an end of the
    edge is chosen, then the one that bends the sheets least. Fins are left out if that leaves
    two faces.
    """
    wall = halves[~is_fin[halves // 3]]
    halves, angles = _sort_around_edge(mesh, wall if len(wall) >= 2 else halves)
    around = fans.of(_end_corners(mesh, halves))
    ring = np.arange(len(halves))
    rings = [np.delete(ring, i) for i in ring] if len(ring) % 2 else [ring]
    matchings = [np.roll(ring, shift).reshape(-1, 2) for ring in rings for shift in (0, 1)]
    shared = [int((around[a] == around[b]).sum()) for a, b in (pairs.T for pairs in matchings)]
    bends = [np.abs(np.pi - np.abs(np.diff(angles[pairs]))).sum() for pairs in matchings]
    best = min(range(len(matchings)), key=lambda k: (-shared[k], bends[k]))
    return halves[matchings[best]], shared[best]


def _end_corners(mesh: Mesh, halves: Int[np.ndarray, "*k"]) -> Int[np.ndarray, "*k 2"]:
    """Corners at the two ends of half-edges, the one at the lower vertex first."""
    corners = np.stack([halves, halves + np.where(halves % 3 < 2, 1, -2)], axis=-1)
    order = np.argsort(mesh.faces.reshape(-1)[corners], axis=-1)
    return np.take_along_axis(corners, order, axis=-1)


def _sort_around_edge(
    mesh: Mesh, halves: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Half-edges of one edge sorted by the angle of their faces around it, and the angles [rad]."""
    start, end = _edge_ends(mesh, halves[0])
    apex = mesh.vertices[mesh.faces[halves // 3, (halves % 3 + 2) % 3]]
    axis = (end - start) / np.linalg.norm(end - start)
    arm = apex - start
    across = arm - np.outer(arm @ axis, axis)
    angles = np.arctan2(across @ np.cross(axis, across[0]), across @ across[0])
    order = np.argsort(angles, kind="stable")
    return halves[order], angles[order]


def _join_corners(
    ends: Int[np.ndarray, "h 2"], pairs: Int[np.ndarray, "k 2"]
) -> Int[np.ndarray, " h"]:
    """Group index of each face corner; faces joined along an edge share its ends."""
    following = pairs + np.where(pairs % 3 < 2, 1, -2)
    same = ends[pairs[:, 0], 0] == ends[pairs[:, 1], 0]
    rows = np.concatenate([pairs[:, 0], following[:, 0]])
    columns = np.concatenate(
        [
            np.where(same, pairs[:, 1], following[:, 1]),
            np.where(same, following[:, 1], pairs[:, 1]),
        ]
    )
    graph = scipy.sparse.coo_matrix(
        (np.ones(len(rows), bool), (rows, columns)), (len(ends), len(ends))
    )
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def _conflict_position(mesh: Mesh, edges: Edges, disagrees: Bool[np.ndarray, " k"]) -> str:
    """Position where a walk over the surface first returns to a face in opposite orientation."""
    pairs = edges.with_count(2)
    left, right = pairs.T // 3
    size = len(mesh.faces)
    sign = {(a, b): d for a, b, d in zip(left, right, disagrees, strict=True)}
    graph = scipy.sparse.coo_matrix((np.ones(len(left), bool), (left, right)), (size, size))
    order, parents = scipy.sparse.csgraph.breadth_first_order(graph, 0, directed=False)
    is_turned = np.zeros(size, bool)
    for face in order[1:]:
        parent = parents[face]
        turn = sign.get((parent, face), sign.get((face, parent)))
        is_turned[face] = is_turned[parent] ^ bool(turn)
    conflict = int(np.argmax(is_turned[left] ^ is_turned[right] ^ disagrees))
    return format_point(mesh.vertices[edges.ends[pairs[conflict, 0]]].mean(axis=0))
