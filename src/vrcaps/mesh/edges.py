"""Edges of triangle meshes, and operations on faces that keep all attributes consistent."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import triangle_areas, triangle_normals

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.mesh.mesh import Mesh


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
    is_used = np.zeros(len(mesh.vertices), bool)
    is_used[mesh.faces] = True
    if is_used.all():
        return mesh
    number = np.cumsum(is_used) - 1
    return take_vertices(mesh, np.nonzero(is_used)[0], number[mesh.faces])


def area_vectors(mesh: Mesh) -> Float[np.ndarray, "m 3"]:
    """Area of each face times its unit normal [m²]."""
    return 0.5 * triangle_normals(mesh.vertices[mesh.faces])


def face_areas(mesh: Mesh) -> Float[np.ndarray, " m"]:
    """Area of each face [m²]."""
    return triangle_areas(mesh.vertices[mesh.faces])


def signed_volume(mesh: Mesh) -> float:
    """Volume inside a closed surface [m³]; negative if its normals point inwards."""
    origin = mesh.vertices.mean(axis=0)
    centers = mesh.vertices[mesh.faces].mean(axis=1) - origin
    return float(np.einsum("ij,ij->", centers, area_vectors(mesh)) / 3.0)
