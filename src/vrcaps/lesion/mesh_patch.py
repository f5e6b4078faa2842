"""Mesh patches: pieces of wall are extracted, refined, and inserted again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.geometry import edge_graph
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.mesh.patch import Patch, rim
from vrcaps.organ.surface import OrganSurface, interpolate

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

NUM_FIELDS = 6
"""Columns of `Patch.fields`: arc length, distance from the centerline, offset to it, and for an
extracted piece the distance along the wall from its center [m]."""

_PER_VERTEX = (
    "clean",
    "moved",
    "normals",
    "clean_normals",
    "theta",
    "fields",
    "label",
    "instance",
    "is_rim",
)


def whole_wall(organ: OrganSurface) -> Patch:
    """Entire wall of an organ, before any lesion."""
    points, _, _ = interpolate(organ.centerline, organ.arc_length)
    vertices = np.asarray(organ.vertices, float)
    normals = vertex_normals(vertices, organ.faces)
    return Patch(
        clean=vertices,
        moved=vertices,
        normals=normals,
        clean_normals=normals,
        theta=np.asarray(organ.theta, float),
        fields=np.column_stack(
            [organ.arc_length, organ.radius, points - vertices, np.zeros(len(vertices))]
        ),
        label=organ.label,
        instance=np.zeros(len(vertices), np.uint16),
        faces=np.asarray(organ.faces),
        uv=np.concatenate([organ.uv, np.zeros_like(organ.uv)], axis=-1),
        chart_id=np.zeros(len(organ.faces), np.int64),
        is_rim=np.zeros(len(vertices), bool),
    )


def within(wall: Patch, sources: Int[np.ndarray, " k"], reach: float) -> Float[np.ndarray, " n"]:
    """Distance [m] along edges from the nearest source; infinite beyond `reach`.

    Args:
        wall: The wall.
        sources: Indices of vertices.
        reach: Maximum distance [m].
    """
    graph = edge_graph(wall.moved, wall.faces).tocsr()
    return scipy.sparse.csgraph.dijkstra(graph, indices=sources, min_only=True, limit=reach)


@dataclass(frozen=True)
class ExtractedPatch:
    """Mesh patch extracted from a wall.

    Attributes:
        patch: Extracted piece.
        vertices: Index in the full wall of each of its first vertices.
        faces: Mask of the faces of the full wall that it replaces.
    """

    patch: Patch
    vertices: Int[np.ndarray, " k"]
    faces: Bool[np.ndarray, " m"]


def extract(wall: Patch, away: Float[np.ndarray, " n"]) -> ExtractedPatch:
    """Extract the faces with a corner within reach.

    Args:
        wall: Full wall.
        away: Distance of each vertex from the center [m], infinite beyond reach.
    """
    near = np.isfinite(away)
    chosen = np.asarray(near[wall.faces].any(axis=1))
    vertices, local = np.unique(wall.faces[chosen], return_inverse=True)
    faces = local.reshape(-1, 3)
    values = {name: getattr(wall, name)[vertices] for name in _PER_VERTEX}
    values["fields"] = values["fields"].copy()
    values["fields"][:, -1] = np.where(near, away, away[near].max(initial=0.0))[vertices]
    values["is_rim"] = rim(faces, len(vertices)) & ~_is_end(wall)[vertices]
    patch = Patch(**values, faces=faces, uv=wall.uv[chosen], chart_id=wall.chart_id[chosen])
    return ExtractedPatch(patch, vertices, chosen)


def insert(wall: Patch, piece: ExtractedPatch, patch: Patch) -> Patch:
    """Insert a refined patch into the wall; existing vertices keep their indices.

    Args:
        wall: Full wall.
        piece: Extracted piece.
        patch: Refined patch of the piece.
    """
    old = len(piece.vertices)
    new_index = np.concatenate(
        [piece.vertices, len(wall.moved) + np.arange(len(patch.moved) - old)]
    )
    joined = {}
    for name in _PER_VERTEX:
        whole, part = getattr(wall, name).copy(), getattr(patch, name)
        part = part[:, : whole.shape[1]] if part.ndim > 1 else part
        whole[piece.vertices] = part[:old]
        joined[name] = np.concatenate([whole, part[old:]])
    joined["is_rim"] = np.zeros(len(joined["clean"]), bool)
    stay = ~piece.faces
    return replace(
        wall,
        **joined,
        faces=np.concatenate([wall.faces[stay], new_index[patch.faces]]),
        uv=np.concatenate([wall.uv[stay], patch.uv]),
        chart_id=np.concatenate([wall.chart_id[stay], patch.chart_id]),
    )


def _is_end(wall: Patch) -> Bool[np.ndarray, " n"]:
    """Vertices at the open ends of the organ, as opposed to a cut."""
    return rim(wall.faces, len(wall.moved))


def as_organ(wall: Patch, organ: OrganSurface, vertices: Float[np.ndarray, "n 3"]) -> OrganSurface:
    """Organ with the wall's faces and the given vertices; textures are still those of `organ`.

    Args:
        wall: Wall.
        organ: Source of all other data.
        vertices: Positions [m].
    """
    return replace(
        organ,
        vertices=vertices,
        faces=wall.faces,
        normals=vertex_normals(vertices, wall.faces),
        uv=wall.uv[..., :2],
        label=wall.label,
        instance=wall.instance.astype(np.uint16),
        arc_length=wall.fields[:, 0],
        theta=wall.theta,
        radius=wall.fields[:, 1],
    )
