"""Triangle meshes: vertices and faces, edges, operations that keep all attributes, distances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.geometry import triangle_areas, triangle_normals

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8, UInt16


@dataclass(frozen=True)
class Mesh:
    """Plain triangle mesh as stored in a file, in meters.

    Attributes:
        vertices: Positions [m].
        faces: Vertex indices of each triangle.
        uv: Texture coordinates of each corner of each face, or None.
        label: Class of each vertex, or None.
        instance: Lesion ID of each vertex, or None.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    uv: Float[np.ndarray, "m 3 2"] | None = None
    label: UInt8[np.ndarray, " n"] | None = None
    instance: UInt16[np.ndarray, " n"] | None = None


def vertex_normals(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    """Unit vertex normals: the area-weighted mean of the normals of adjacent faces."""
    normals = sums_at_vertices(triangle_normals(vertices[faces]), faces, len(vertices))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0.0, length, 1.0)


def sums_at_vertices(
    vectors: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "m 3"], count: int
) -> Float[np.ndarray, "n 3"]:
    """Sum of a vector per face over the faces at each vertex.

    Args:
        vectors: Vector of each face.
        faces: Vertex indices.
        count: Number of vertices.
    """
    sums = np.zeros((count, 3))
    for axis in range(3):
        sums[:, axis] = sum(
            np.bincount(faces[:, corner], vectors[:, axis], count) for corner in range(3)
        )
    return sums


def used_vertices(
    faces: Int[np.ndarray, "m 3"], count: int
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "m 3"]]:
    """Indices of the vertices in use, and faces that refer to these alone.

    Args:
        faces: Vertex indices.
        count: Number of vertices.
    """
    is_used = np.zeros(count, bool)
    is_used[faces] = True
    used = np.flatnonzero(is_used)
    index = np.empty(count, int)
    index[used] = np.arange(len(used))
    return used, index[faces]


@dataclass(frozen=True)
class Edges:
    """Half-edges of a mesh; half-edge ``3 f + k`` runs from corner k to corner k+1 of face f.

    Attributes:
        ends: First and last vertex of each half-edge.
        order: Half-edge indices sorted so that those of one edge are adjacent.
        first: Start of each edge in `order`.
        counts: Number of half-edges (faces) of each edge.
    """

    ends: Int[np.ndarray, "h 2"]
    order: Int[np.ndarray, " h"]
    first: Int[np.ndarray, " e"]
    counts: Int[np.ndarray, " e"]

    def with_count(self, count: int) -> Int[np.ndarray, "k count"]:
        """Half-edges of each edge with exactly this number of them."""
        first = self.first[self.counts == count]
        return self.order[first[:, None] + np.arange(count)]

    def nonmanifold(self) -> list[Int[np.ndarray, " k"]]:
        """Half-edges of each edge with more than two."""
        many = np.nonzero(self.counts > 2)[0]
        return [self.order[self.first[e] : self.first[e] + self.counts[e]] for e in many]


def directed_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "h 2"]:
    """First and last vertex of each half-edge; on a closed surface each edge occurs twice."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)


def distinct_rows(
    rows: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, " n"]]:
    """Distinct rows in lexicographic order, and the index of each row among them.

    `np.unique` compares rows one after the other, which takes eight times as long.
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    is_first = np.ones(len(rows), bool)
    is_first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    inverse = np.empty(len(rows), np.int64)
    inverse[order] = np.cumsum(is_first) - 1
    return ordered[is_first], inverse


def find_edges(faces: Int[np.ndarray, "m 3"]) -> Edges:
    """Half-edges of a mesh, grouped by edge."""
    ends = directed_edges(faces)
    one, other = ends.T
    key = np.minimum(one, other) * (faces.max(initial=0) + 1) + np.maximum(one, other)
    order = np.argsort(key, kind="stable")
    is_first = np.diff(key[order], prepend=-1) > 0
    first = np.nonzero(is_first)[0]
    return Edges(ends, order, first, np.diff(np.append(first, len(order))))


def keep_faces(mesh: Mesh, keep: Bool[np.ndarray, " m"]) -> Mesh:
    """Mesh with some of its faces; vertices are kept."""
    return replace(mesh, faces=mesh.faces[keep], uv=None if mesh.uv is None else mesh.uv[keep])


def flip_faces(mesh: Mesh, is_flipped: Bool[np.ndarray, " m"]) -> Mesh:
    """Mesh with the winding of some faces reversed."""
    faces = np.where(is_flipped[:, None], mesh.faces[:, ::-1], mesh.faces)
    if mesh.uv is None:
        return replace(mesh, faces=faces)
    return replace(
        mesh, faces=faces, uv=np.where(is_flipped[:, None, None], mesh.uv[:, ::-1], mesh.uv)
    )


def split_face(
    mesh: Mesh, face: int, side: int, at: tuple[int, float]
) -> tuple[Int[np.ndarray, "2 3"], Float[np.ndarray, "2 3 2"] | None]:
    """Split a face and its uv in two at a vertex on the edge that leaves corner `side`.

    Args:
        mesh: The mesh.
        face: Index of the face.
        side: Corner that the split edge leaves.
        at: Vertex index, and its position along the edge, 0 to 1.
    """
    vertex, fraction = at
    turn = [side, (side + 1) % 3, (side + 2) % 3]
    a, b, c = mesh.faces[face, turn]
    faces = np.array([[a, vertex, c], [vertex, b, c]])
    if mesh.uv is None:
        return faces, None
    uv_a, uv_b, uv_c = mesh.uv[face, turn]
    uv = uv_a + fraction * (uv_b - uv_a)
    return faces, np.array([[uv_a, uv, uv_c], [uv, uv_b, uv_c]])


def take_vertices(mesh: Mesh, source: Int[np.ndarray, " k"], faces: Int[np.ndarray, "m 3"]) -> Mesh:
    """Mesh with vertices gathered from the old ones by index, and faces over the new ones."""
    label = None if mesh.label is None else mesh.label[source]
    instance = None if mesh.instance is None else mesh.instance[source]
    vertices = mesh.vertices[source]
    return replace(mesh, vertices=vertices, faces=faces, label=label, instance=instance)


def drop_unused_vertices(mesh: Mesh) -> Mesh:
    """Mesh without unused vertices; the others keep their order."""
    used, faces = used_vertices(mesh.faces, len(mesh.vertices))
    return mesh if len(used) == len(mesh.vertices) else take_vertices(mesh, used, faces)


def area_vectors(mesh: Mesh) -> Float[np.ndarray, "m 3"]:
    """Area of each face times its unit normal [m²]."""
    # Rows are taken in half the time of an index.
    return 0.5 * triangle_normals(mesh.vertices.take(mesh.faces, axis=0))


def face_areas(mesh: Mesh) -> Float[np.ndarray, " m"]:
    """Area of each face [m²]."""
    return triangle_areas(mesh.vertices[mesh.faces])


def signed_volume(mesh: Mesh) -> float:
    """Volume inside a closed surface [m³]; negative if its normals point inwards."""
    origin = mesh.vertices.mean(axis=0)
    centers = mesh.vertices[mesh.faces].mean(axis=1) - origin
    return float(np.einsum("ij,ij->", centers, area_vectors(mesh)) / 3.0)


def triangulate_fans(counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Triangles of concatenated polygons, as a fan about each first corner.

    Args:
        counts: Number of corners of each polygon; one with fewer than 3 gives no triangle.

    Returns:
        Positions of each triangle's corners in the concatenated corner list.
    """
    first, step = _steps(counts)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def triangulate_strips(counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Triangles of concatenated strips; every second one is flipped for consistent orientation.

    Args:
        counts: Number of corners of each strip; one with fewer than 3 gives no triangle.

    Returns:
        Positions of each triangle's corners in the concatenated corner list.
    """
    first, step = _steps(counts)
    start, odd = first + step, step % 2
    return np.stack([start, start + 1 + odd, start + 2 - odd], axis=1)


def _steps(counts: Int[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """First corner of each triangle's list, and the triangle's index in it."""
    counts = np.asarray(counts, np.int64)
    num_triangles = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, num_triangles)
    before = np.repeat(np.cumsum(num_triangles) - num_triangles, num_triangles)
    return first, np.arange(len(first)) - before


_CHUNK = 64  # points per batch, to limit memory


def wall_distance(
    points: Float[np.ndarray, "k 3"],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, " k"]:
    """Exact distance from each point to the nearest point of any triangle [m].

    Triangles whose bounding sphere lies beyond the nearest vertex are skipped.
    """
    corners = vertices[faces]
    middle = 0.5 * (corners.min(axis=1) + corners.max(axis=1))
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    limit, _ = scipy.spatial.KDTree(vertices[np.unique(faces)]).query(points)
    # Group triangles by size, so that a few large ones do not widen the search for all others.
    bounds = np.quantile(reach, [0.0, 0.5, 0.9, 0.99, 1.0])
    bin_of = np.clip(np.searchsorted(bounds, reach, side="left") - 1, 0, 3)
    distance = limit.copy()
    for bin_id in range(4):
        ids = np.flatnonzero(bin_of == bin_id)
        if not len(ids):
            continue
        tree, widest = scipy.spatial.KDTree(middle[ids]), reach[ids].max()
        for first in range(0, len(points), _CHUNK):
            rows = slice(first, first + _CHUNK)
            near = tree.query_ball_point(points[rows], distance[rows] + widest)
            owner = np.repeat(np.arange(len(near)), [len(group) for group in near])
            face = ids[np.concatenate(near).astype(int)]
            chunk = points[rows][owner]
            close = (
                np.linalg.norm(chunk - middle[face], axis=1) < distance[rows][owner] + reach[face]
            )
            owner, face = owner[close], face[close]
            nearer = triangle_distance(points[rows][owner], corners[face])
            np.minimum.at(distance, first + owner, nearer)
    return distance


def triangle_distance(
    points: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, " k"]:
    """Distance from each point to its own triangle: to the face if above it, else to an edge."""
    edges = np.roll(corners, -1, axis=1) - corners
    offset = points[:, None] - corners
    length2 = (edges**2).sum(axis=2)
    t = np.clip((offset * edges).sum(axis=2) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    to_edge = np.linalg.norm(offset - t[..., None] * edges, axis=2).min(axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(normal, axis=1)
    side = (np.cross(edges, offset) * normal[:, None]).sum(axis=2)
    over = (side >= 0.0).all(axis=1) & (area > 0.0)
    height = np.abs((offset[:, 0] * normal).sum(axis=1)) / np.where(area > 0.0, area, 1.0)
    return np.where(over, height, to_edge)
