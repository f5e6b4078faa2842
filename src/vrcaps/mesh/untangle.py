"""Untangling: small patches of a deformed mesh are relaxed until no triangles intersect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.geometry import edge_graph
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import used_vertices
from vrcaps.mesh.self_intersection import self_intersections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import SuperLU

_NEAR = 8 * MM
"""Distance from an intersection within which triangles are examined while patches grow [m]."""
_ROUNDS = 8
"""Maximum number of times that patches grow by a ring of vertices."""
_MOST = 2000
"""Maximum number of vertices to move."""


@dataclass(frozen=True)
class HarmonicPatch:
    """Connected vertices, each of which lies at the mean of its neighbors.

    Attributes:
        inside: Indices of these vertices.
        border: Indices of their other neighbors, which determine their positions.
        laplacian: Number of neighbors of each vertex inside, minus 1 at each neighbor inside.
        reach: 1 at each neighbor on the border.
    """

    inside: Int[np.ndarray, " k"]
    border: Int[np.ndarray, " b"]
    laplacian: csr_array
    reach: csr_array

    def positions(self, border: Float[np.ndarray, "b c"]) -> Float[np.ndarray, "k c"]:
        """Positions of the vertices inside, given those of the border [m]."""
        return np.asarray(self._factors.solve(self.reach @ border))

    @cached_property
    def _factors(self) -> SuperLU:
        from scipy.sparse.linalg import splu

        return splu(self.laplacian.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0)


def untangle(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[HarmonicPatch, ...]:
    """Return patches whose relaxation removes the self-intersections of a folded surface.

    A fold that is too steep for its triangles turns some of them over. Their vertices and a ring of
    neighbors form patches, which grow by up to eight rings, until the relaxed surface has no
    intersections near them. The positions are those of a discrete harmonic map with equal weights
    (Tutte 1963, "How to draw a graph", Proc. London Math. Soc. s3-13:743).

    Finds intersections next to triangles that are turned over, by more than 90° from the mean
    normal of a vertex; not those of distant parts of the surface. A surface with more than 2,000
    vertices to move is not tangled by a few steep folds, and gets no patches.

    Args:
        vertices: Positions [m].
        faces: Vertex indices.
    """
    used, faces = used_vertices(faces, len(vertices))
    patches = _patches(vertices[used], faces)
    return tuple(
        replace(patch, inside=used[patch.inside], border=used[patch.border]) for patch in patches
    )


def _patches(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[HarmonicPatch, ...]:
    """Patches that remove the self-intersections of a surface."""
    suspect = np.flatnonzero(_next_to_turned(vertices, faces))
    tangled = np.unique(faces[suspect[self_intersections(vertices, faces[suspect])]])
    if not 0 < len(tangled) <= _MOST:
        return ()
    near = faces[_has_any(faces, _is_near(vertices, vertices[tangled]))]
    patches: tuple[HarmonicPatch, ...] = ()
    for _ in range(_ROUNDS):
        inside = _with_neighbors(tangled, near)
        if len(inside) > _MOST:
            return ()
        patches = _harmonic_patches(inside, vertices, near)
        pairs = self_intersections(relaxed(vertices, patches), near)
        if not len(pairs):
            break
        tangled = np.union1d(tangled, near[pairs])
    return patches


def relaxed(
    vertices: Float[np.ndarray, "n 3"], patches: tuple[HarmonicPatch, ...]
) -> Float[np.ndarray, "n 3"]:
    """Vertices with those inside the patches at the means of their neighbors [m].

    Args:
        vertices: Vertices of the surface [m].
        patches: Result of `untangle`.
    """
    moved = vertices.copy()
    relax(moved, patches)
    return moved


def relax(
    vertices: Float[np.ndarray, "n 3"],
    patches: tuple[HarmonicPatch, ...],
    weight: Float[np.ndarray, " n"] | None = None,
    *,
    first: int = 0,
) -> None:
    """Move vertices inside the patches to the means of their neighbors, in place.

    Args:
        vertices: Consecutive vertices of the surface [m]; patches that reach beyond them stay.
        patches: Result of `untangle`.
        weight: Fraction of the displacement that applies to each vertex; None for all of it.
        first: Index of the first vertex in the surface.
    """
    for patch in patches:
        inside, border = patch.inside - first, patch.border - first
        ends = np.concatenate([inside, border])
        if ends.min() < 0 or ends.max() >= len(vertices):
            continue
        goal = patch.positions(vertices[border])
        if weight is not None:
            goal = vertices[inside] + weight[inside, None] * (goal - vertices[inside])
        vertices[inside] = goal


def _next_to_turned(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Bool[np.ndarray, " m"]:
    """Whether each triangle is turned over or has a vertex in common with one that is."""
    touched = np.zeros(len(vertices), bool)
    touched[faces[_core.turned_triangles(vertices, faces)]] = True
    return _has_any(faces, touched)


def _has_any(
    faces: Int[np.ndarray, "m 3"], is_chosen: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " m"]:
    """Whether each triangle has a chosen vertex."""
    first, second, third = is_chosen[faces].T
    return np.asarray(first | second | third)


def _is_near(
    vertices: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "k 3"]
) -> Bool[np.ndarray, " n"]:
    """Whether each vertex is near one of the points."""
    import scipy.spatial

    distance = scipy.spatial.KDTree(points).query(vertices, distance_upper_bound=_NEAR)[0]
    return np.asarray(np.isfinite(distance))


def _with_neighbors(
    vertices: Int[np.ndarray, " k"], faces: Int[np.ndarray, "m 3"]
) -> Int[np.ndarray, " l"]:
    """Indices of vertices and of those that share a triangle with them."""
    return np.unique(faces[np.isin(faces, vertices).any(axis=1)])


def _harmonic_patches(
    inside: Int[np.ndarray, " k"],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> tuple[HarmonicPatch, ...]:
    """Patch of each connected part of the vertices inside."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.csgraph import connected_components

    linked = edge_graph(vertices, faces).tocsr()[inside] > 0.0
    count, part = connected_components(linked[:, inside], directed=False)
    patches = []
    for index in range(count):
        rows = linked[part == index]
        members, reached = inside[part == index], np.unique(rows.indices)
        border = np.setdiff1d(reached, members)
        links, degree = rows.astype(float), np.diff(rows.indptr).astype(float)
        laplacian = csr_array(diags_array(degree) - links[:, members])
        patches.append(HarmonicPatch(members, border, laplacian, csr_array(links[:, border])))
    return tuple(patches)
