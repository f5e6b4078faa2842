"""Connected components of a surface: the one around the lumen, and walls with a thickness."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_normals
from vrcaps.core.units import MM
from vrcaps.mesh.edges import (
    drop_unused_vertices,
    face_areas,
    find_edges,
    flip_faces,
    keep_faces,
    signed_volume,
)
from vrcaps.mesh.mesh import wall_of
from vrcaps.mesh.repair.cap import close_loops, find_loops
from vrcaps.mesh.repair.manifold import orient_consistently
from vrcaps.mesh.repair.repair_report import Repair

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.mesh.mesh import Mesh

_PART_AREA = 1e-3  # of the whole; smaller stray components are not reported individually
_LINING_AREA = 0.2  # of the outer surface; a larger inner one is the lumen, not a body in it
_LINING_SIZE = 0.7  # same for the diagonals of the bounding boxes
_WITHIN = 0.8  # of the vertices that must lie inside; those at flush ends may not
_SAMPLES = 500
_SHEET = 1.3  # thickness relative to a plate of the same volume and area; a tube has 2
_FACING = 0.9  # of wall samples with one further intersection of the ray on one side


def keep_lumen_component(
    mesh: Mesh, origin: Int[np.ndarray, " n"]
) -> tuple[Mesh, Int[np.ndarray, " n"], list[Repair]]:
    """Keep the connected part around the lumen: the largest or, in a thick wall, the inner one.

    mesh: Surface without non-manifold vertices.
        mesh: A surface without non-manifold vertices.
        origin: Index for each vertex, to be carried along.
    """
    ends = find_edges(mesh.faces).ends
    size = len(mesh.vertices)
    graph = scipy.sparse.coo_matrix(
        (np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), (size, size)
    )
    num_parts, vertex_part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    if num_parts == 1:
        return mesh, origin, []
    face_part = vertex_part[mesh.faces[:, 0]]
    areas = np.bincount(face_part, face_areas(mesh), num_parts)
    chosen, outer = _around_lumen(mesh, face_part, areas)
    sums = [np.bincount(vertex_part, mesh.vertices[:, axis], num_parts) for axis in range(3)]
    centers = np.stack(sums, axis=1) / np.bincount(vertex_part, minlength=num_parts)[:, None]
    order = np.argsort(-areas)
    strays = order[~np.isin(order, [chosen, *outer])]
    kept = keep_faces(mesh, face_part == chosen)
    kept_origin = origin[np.unique(kept.faces)]
    kept = drop_unused_vertices(kept)
    repairs = []
    if outer:
        thickness = _distance(kept, _part(mesh, face_part, outer[-1]))
        text = f"removed, the surface {thickness / MM:.1f} mm inside it is taken as the lumen"
        repairs.append(Repair("outer surface of the wall", len(outer), text, centers[outer]))
    if len(strays):
        fractions = areas[strays] / areas.sum()
        named = [f"{100 * fraction:.2g} %" for fraction in fractions if fraction >= _PART_AREA][:5]
        sizes = f"areas {', '.join(named)}" if named else f"all below {100 * _PART_AREA:g} %"
        action = f"removed ({sizes} of the whole)"
        repairs.append(Repair("stray component", len(strays), action, centers[strays]))
    return kept, kept_origin, repairs


def _around_lumen(
    mesh: Mesh, face_part: Int[np.ndarray, " m"], areas: Float[np.ndarray, " p"]
) -> tuple[int, list[int]]:
    """Index of the part around the lumen, and of the parts around it, the outermost first."""
    order = np.argsort(-areas)
    chosen, outer = int(order[0]), []
    surface = None
    for number in order[1:][areas[order[1:]] >= _LINING_AREA * areas[chosen]].tolist():
        surface = _part(mesh, face_part, chosen) if surface is None else surface
        inner = _part(mesh, face_part, number)
        if _size(inner) >= _LINING_SIZE * _size(surface) and _lies_within(inner, surface):
            outer.append(chosen)
            chosen, surface = number, inner
    return chosen, outer


def _part(mesh: Mesh, face_part: Int[np.ndarray, " m"], number: int) -> Mesh:
    return drop_unused_vertices(keep_faces(mesh, face_part == number))


def _size(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def _lies_within(inner: Mesh, outer: Mesh) -> bool:
    """Whether a surface lies within another one, whose open ends count as closed."""
    outer, _ = orient_consistently(outer)
    outer = close_loops(outer, find_loops(outer))
    if signed_volume(outer) > 0.0:
        outer = flip_faces(outer, np.ones(len(outer.faces), bool))
    wall = wall_of(outer.vertices, outer.faces)
    return bool((wall.signed_distance(_sample(inner.vertices)) > 0.0).mean() >= _WITHIN)


def _distance(mesh: Mesh, other: Mesh) -> float:
    """Median distance of a surface from another [m]."""
    points = _sample(mesh.vertices)
    nearest, _ = wall_of(other.vertices, other.faces).closest_point(points)
    return float(np.median(np.linalg.norm(points - nearest, axis=1)))


def _sample(rows: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 3"]:
    return np.ascontiguousarray(rows[:: max(1, len(rows) // _SAMPLES)])


def require_lumen_surface(mesh: Mesh) -> None:
    """Check that one closed surface encloses a lumen, not the tissue of a wall around it.

    The inner and outer side of such a wall are joined at the ends, and it is a plate: the distance
    through it is twice its volume over its area (4 times in a round lumen), and from one of its two
    sides, that of the lumen, a ray intersects the surface once more.

    Args:
        mesh: Closed wall, faces counter-clockwise seen from the enclosed side.

    Raises:
        InputError: If it is a wall with a thickness.
    """
    area, volume = float(face_areas(mesh).sum()), abs(signed_volume(mesh))
    plate = 2.0 * volume / area
    normals = triangle_normals(mesh.vertices[mesh.faces])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    centers = mesh.vertices[mesh.faces].mean(axis=1)
    share = np.cumsum(face_areas(mesh)) / area
    face = np.searchsorted(share, (np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    face = face.clip(0, len(share) - 1)
    wall, skin = wall_of(mesh.vertices, mesh.faces), 0.01 * plate
    through, behind = wall.cast(centers[face] + skin * normals[face], normals[face])
    if not np.nanmedian(through) < _SHEET * plate:
        return
    seen = behind >= 0
    face, behind, through = face[seen], behind[seen], through[seen]
    other = centers[face] + (skin + through[:, None]) * normals[face]
    front = wall.cast(centers[face] - skin * normals[face], -normals[face])[1] >= 0
    back = wall.cast(other - skin * normals[behind], -normals[behind])[1] >= 0
    if (front | back).mean() > _FACING:
        raise InputError(
            f"The mesh is a wall about {plate / MM:.1f} mm thick: its surface encloses the tissue, "
            "not the lumen. Give the inner surface alone."
        )
