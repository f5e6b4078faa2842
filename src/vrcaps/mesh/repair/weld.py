"""Duplicate vertices, degenerate triangles and duplicate faces."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.mesh.mesh import (
    distinct_rows,
    drop_unused_vertices,
    find_edges,
    keep_faces,
    split_face,
    take_vertices,
)
from vrcaps.mesh.repair.repair_report import Repair

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.mesh.mesh import Mesh

_MERGE_TOLERANCE = 1e-6  # of the bounding box's diagonal; a few float32 steps
_THIN = 1e-5  # height over longest edge, below which a triangle has no usable normal
_NEEDLE = 0.01  # shortest over longest edge, below which a thin triangle is a needle
_MAX_PASSES = 10
_MAX_PAIRS = 50_000_000  # of near vertices: 1 GB


def merge_vertices(mesh: Mesh) -> tuple[Mesh, list[Repair]]:
    """Merge vertices closer than 1e-6 of the mesh's diagonal and drop unused ones.

    Raises:
        InputError: If too many are that close.
    """
    repairs = []
    num_vertices = len(mesh.vertices)
    mesh = drop_unused_vertices(mesh)
    if len(mesh.vertices) < num_vertices:
        unused = num_vertices - len(mesh.vertices)
        repairs.append(Repair("unused vertex", unused, "removed"))
    tolerance = _MERGE_TOLERANCE * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    unique, index = distinct_rows(mesh.vertices)
    _require_apart(unique, tolerance)
    pairs = scipy.spatial.KDTree(unique).query_pairs(tolerance, output_type="ndarray")
    group = _group(pairs, len(unique))[index]
    merged = _merge_groups(mesh, group)
    num_merged = len(mesh.vertices) - len(merged.vertices)
    if num_merged:
        repairs.append(Repair("duplicate vertex", num_merged, "merged"))
    return merged, repairs


def _require_apart(points: Float[np.ndarray, "n 3"], tolerance: float) -> None:
    """Check that merging needs no more memory than the mesh.

    Raises:
        InputError: If thousands of different vertices are within a millionth of the mesh.
    """
    if not tolerance > 0.0:
        return
    steps = np.minimum((points - points.min(axis=0)) / tolerance, 1 << 20)  # at most 10⁶
    cells = steps.astype(np.int64)
    counts = np.unique(cells @ [1 << 42, 1 << 21, 1], return_counts=True)[1]
    if (counts.astype(float) ** 2).sum() > len(points) + _MAX_PAIRS:
        raise InputError(
            f"{counts.max()} different vertices lie within {tolerance:.2g} m of each other, a "
            "millionth of the mesh. Remove stray vertices, or check its unit."
        )


def remove_degenerate_faces(mesh: Mesh) -> tuple[Mesh, list[Repair]]:
    """Remove triangles without area, leaving no gap.

    A needle's short edge is collapsed; a triangle whose apex lies on its longest edge is
    merged into the neighbor across that edge, which is split at the apex.
    """
    count, positions = 0, []
    for _ in range(_MAX_PASSES):
        is_collapsed = _has_repeated_corner(mesh.faces)
        count += int(is_collapsed.sum())
        positions.append(mesh.vertices[mesh.faces[is_collapsed]].mean(axis=1))
        mesh = keep_faces(mesh, ~is_collapsed)
        lengths, heights = _edge_lengths(mesh)
        longest, shortest = lengths.max(axis=1), lengths.min(axis=1)
        is_thin = heights <= _THIN * longest
        is_needle = is_thin & (shortest <= _NEEDLE * longest)
        if not is_thin.any():
            break
        if is_needle.any():
            ends = mesh.faces[is_needle][:, [[0, 1], [1, 2], [2, 0]]]
            pairs = ends[np.arange(len(ends)), lengths[is_needle].argmin(axis=1)]
            mesh = _merge_groups(mesh, _group(pairs, len(mesh.vertices)))
        else:
            thin = np.nonzero(is_thin)[0]
            mesh, split_points = _split_neighbors(mesh, thin, lengths[thin].argmax(axis=1))
            count += len(split_points)
            positions.append(split_points)
    mesh = drop_unused_vertices(mesh)
    if count == 0:
        return mesh, []
    return mesh, [Repair("degenerate triangle", count, "removed", np.concatenate(positions))]


def remove_duplicate_faces(mesh: Mesh) -> tuple[Mesh, list[Repair]]:
    """Keep one of the triangles with the same three vertices, in any order."""
    corners = np.sort(mesh.faces, axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    is_first = np.zeros(len(corners), bool)
    is_first[first] = True
    if is_first.all():
        return mesh, []
    positions = mesh.vertices[mesh.faces[~is_first]].mean(axis=1)
    kept = drop_unused_vertices(keep_faces(mesh, is_first))
    return kept, [Repair("duplicate triangle", len(positions), "removed", positions)]


def _group(pairs: Int[np.ndarray, "k 2"], count: int) -> Int[np.ndarray, " n"]:
    """Group index of each of `count` items, connected by pairs."""
    graph = scipy.sparse.coo_matrix(
        (np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (count, count)
    )
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def _merge_groups(mesh: Mesh, group: Int[np.ndarray, " n"]) -> Mesh:
    """Merge each group to one vertex (the first); vertices keep their order."""
    _, first, index = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return take_vertices(mesh, first[order], rank[index.reshape(-1)][mesh.faces])


def _has_repeated_corner(faces: Int[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
    return np.any(faces == np.roll(faces, 1, axis=1), axis=1)


def _edge_lengths(mesh: Mesh) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Lengths of each face's edges (edge k leaves corner k) and its height on the longest [m]."""
    corners = mesh.vertices[mesh.faces]
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return lengths, double_area / np.maximum(lengths.max(axis=1), np.finfo(float).tiny)


def _split_neighbors(
    mesh: Mesh, thin: Int[np.ndarray, " k"], longest: Int[np.ndarray, " k"]
) -> tuple[Mesh, Float[np.ndarray, "j 3"]]:
    """Remove each thin face and split the face across its longest edge at the thin one's apex.

    Faces that share a neighbor with one that is already split wait for the next pass.
    """
    edges = find_edges(mesh.faces)
    edge_of = np.empty(len(edges.order), np.int64)
    edge_of[edges.order] = np.repeat(np.arange(len(edges.first)), edges.counts)
    keep = np.ones(len(mesh.faces), bool)
    is_busy = np.zeros(len(mesh.faces), bool)
    new_faces, new_uvs, positions = [], [], []
    for face, side in zip(thin, longest, strict=True):
        edge = edge_of[3 * face + side]
        start = edges.first[edge]
        around = edges.order[start : start + edges.counts[edge]]
        others = around[around // 3 != face]
        if is_busy[face] or is_busy[others // 3].any():
            continue
        is_busy[face] = True
        keep[face] = False
        apex = int(mesh.faces[face, (side + 2) % 3])
        positions.append(mesh.vertices[apex])
        for half in others:
            is_busy[half // 3], keep[half // 3] = True, False
            share = _share_along(mesh, half, apex)
            faces, uvs = split_face(mesh, half // 3, half % 3, (apex, share))
            new_faces.append(faces)
            new_uvs.append(uvs)
    kept = keep_faces(mesh, keep)
    faces = np.concatenate([kept.faces, *new_faces])
    uv = None if kept.uv is None else np.concatenate([kept.uv, *new_uvs])
    return replace(kept, faces=faces, uv=uv), np.array(positions)


def _share_along(mesh: Mesh, half: int, vertex: int) -> float:
    """Relative position of a vertex along a half-edge, 0 to 1."""
    face, side = divmod(int(half), 3)
    start, end = mesh.vertices[mesh.faces[face, [side, (side + 1) % 3]]]
    share = np.dot(mesh.vertices[vertex] - start, end - start) / np.dot(end - start, end - start)
    return float(np.clip(share, 0.0, 1.0))
