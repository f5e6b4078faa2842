"""Components and openings: the surface around the lumen, and caps on its holes and open ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_normals, wall_of
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import (
    drop_unused_vertices,
    face_areas,
    find_edges,
    flip_faces,
    keep_faces,
    signed_volume,
)
from vrcaps.mesh.repair.manifold import orient_consistently
from vrcaps.mesh.repair.repair_report import Repair

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.mesh.mesh import Mesh


@dataclass(frozen=True)
class Loop:
    """Closed border of an oriented surface.

    Attributes:
        vertices: Vertex indices in the direction of a cap along the border.
        halves: The cap runs from vertex k to k+1 against this half-edge of the surface.
        center: Mean of the border's vertices [m].
        perimeter: Length of the border [m].
        fan_area: Area of the triangles between the border and its center [m²].
        fan_volume: Signed volume that those triangles add to the surface's, about `origin`.
    """

    vertices: Int[np.ndarray, " n"]
    halves: Int[np.ndarray, " n"]
    center: Float[np.ndarray, " 3"]
    perimeter: float
    fan_area: float
    fan_volume: float

    @property
    def diameter(self) -> float:
        """Diameter of the circle with the same perimeter [m]."""
        return self.perimeter / math.pi


def find_loops(mesh: Mesh) -> list[Loop]:
    """Borders of an oriented manifold, each a simple loop, in order of their lowest vertex."""
    edges = find_edges(mesh.faces)
    border = edges.with_count(1)[:, 0]
    # A cap runs against the surface: from the end of a border half-edge to its start.
    leaving = dict(zip(edges.ends[border, 1].tolist(), border.tolist(), strict=True))
    origin = mesh.vertices.mean(axis=0)
    loops = []
    for seed in sorted(leaving):
        vertices, halves = [], []
        vertex = seed
        while vertex in leaving:
            half = leaving.pop(vertex)
            vertices.append(vertex)
            halves.append(half)
            vertex = int(edges.ends[half, 0])
        if vertices:
            loops.append(_make_loop(mesh, np.array(vertices), np.array(halves), origin))
    return loops


def _make_loop(
    mesh: Mesh, vertices: np.ndarray, halves: np.ndarray, origin: Float[np.ndarray, " 3"]
) -> Loop:
    points = mesh.vertices[vertices]
    center = points.mean(axis=0)
    following = np.roll(points, -1, axis=0)
    areas = 0.5 * np.cross(points - center, following - center)
    centroids = (points + following + center) / 3.0 - origin
    return Loop(
        vertices=vertices,
        halves=halves,
        center=center,
        perimeter=float(np.linalg.norm(following - points, axis=1).sum()),
        fan_area=float(np.linalg.norm(areas, axis=1).sum()),
        fan_volume=float(np.einsum("ij,ij->", centroids, areas) / 3.0),
    )


def enclosed_volume(mesh: Mesh, loops: list[Loop]) -> float:
    """Signed volume [m³] with every border closed by a fan; negative if normals point inwards."""
    return signed_volume(mesh) + sum(loop.fan_volume for loop in loops)


def mean_diameter(mesh: Mesh, loops: list[Loop]) -> float:
    """Diameter [m] of the cylinder with the same volume and wall area, 4 V / A."""
    return 4.0 * abs(enclosed_volume(mesh, loops)) / float(face_areas(mesh).sum())


def close_loops(mesh: Mesh, loops: list[Loop]) -> Mesh:
    """Close borders by membranes with triangles about as large as those along each border.

    Texture coordinates are interpolated from those along the border; a cap has the border's most
    frequent label. The mesh is copied once, regardless of the number of borders.
    """
    if not loops:
        return mesh
    caps = [_make_cap(mesh, loop) for loop in loops]
    num_new = [len(inner) for _, inner in caps]
    starts = len(mesh.vertices) + np.cumsum([0, *num_new[:-1]])
    faces = [mesh.faces]
    for loop, start, (cap, inner) in zip(loops, starts, caps, strict=True):
        faces.append(np.append(loop.vertices, start + np.arange(len(inner)))[cap])
    values = np.concatenate([inner for _, inner in caps])
    label, uv = mesh.label, mesh.uv
    if label is not None:
        own = [np.bincount(label[loop.vertices]).argmax() for loop in loops]
        label = np.concatenate([label, np.repeat(own, num_new).astype(label.dtype)])
    if uv is not None:
        cap_uv = [
            np.concatenate([_border_uv(mesh, loop), inner[:, 3:]])[cap]
            for loop, (cap, inner) in zip(loops, caps, strict=True)
        ]
        uv = np.concatenate([uv, *cap_uv])
    vertices = np.concatenate([mesh.vertices, values[:, :3]])
    return replace(mesh, vertices=vertices, faces=np.concatenate(faces), uv=uv, label=label)


def _make_cap(mesh: Mesh, loop: Loop) -> tuple[Int[np.ndarray, "t 3"], Float[np.ndarray, "k c"]]:
    """Triangles over a border, and its inner vertices with their texture coordinates, if any.

    The border's vertices have the first indices, the inner ones follow. Rings of vertices shrink
    towards the center, adjacent rings are zipped together, and each inner vertex moves to the mean
    of its neighbors (a discrete membrane), so that the cap follows a non-planar border.
    """
    count = len(loop.vertices)
    rings, start = [np.arange(count)], count
    for size in _ring_sizes(count):
        rings.append(np.arange(start, start + size))
        start += size
    positions = _loop_positions(mesh, loop)
    zipped = [_zip_rings(outer, inner, positions) for outer, inner in pairwise(rings)]
    faces = np.concatenate(zipped or [rings[0][None, :]])
    border = mesh.vertices[loop.vertices]
    known = border if mesh.uv is None else np.hstack([border, _border_uv(mesh, loop)])
    return faces, _membrane(faces, known, start - count)


def _ring_sizes(count: int) -> list[int]:
    """Vertices of each inner ring; rows are as high as an equilateral triangle on the border.

    A circle of n edges of length h has radius n h / 2π and holds n / (√3 π) rows of height
    h √3 / 2; the last ring is a single vertex.
    """
    if count == 3:
        return []
    num_rows = max(1, round(count / (math.sqrt(3.0) * math.pi)))
    sizes = [max(3, round(count * (1.0 - row / num_rows))) for row in range(1, num_rows)]
    return [*sizes, 1]


def _loop_positions(mesh: Mesh, loop: Loop) -> Float[np.ndarray, " n"]:
    """Fraction of the perimeter before each vertex, 0 to 1."""
    points = mesh.vertices[loop.vertices]
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    return (np.cumsum(steps) - steps) / steps.sum()


def _zip_rings(
    outer: Int[np.ndarray, " n"], inner: Int[np.ndarray, " k"], positions: Float[np.ndarray, " p"]
) -> Int[np.ndarray, "t 3"]:
    """Triangles between two rings; each step advances to the nearer next vertex.

    Only the border's vertices are unevenly spaced, at `positions` along it.
    """
    along_outer = positions if len(outer) == len(positions) else np.arange(len(outer)) / len(outer)
    if len(inner) == 1:
        return np.stack([outer, np.roll(outer, -1), np.full(len(outer), inner[0])], axis=1)
    along_inner = np.arange(len(inner)) / len(inner)
    after_outer, after_inner = np.append(along_outer, 1.0)[1:], np.append(along_inner, 1.0)[1:]
    faces = []
    i = j = 0
    while i < len(outer) or j < len(inner):
        next_outer = after_outer[i] if i < len(outer) else np.inf
        next_inner = after_inner[j] if j < len(inner) else np.inf
        a, b = outer[i % len(outer)], inner[j % len(inner)]
        if next_outer <= next_inner:
            faces.append((a, outer[(i + 1) % len(outer)], b))
            i += 1
        else:
            faces.append((a, inner[(j + 1) % len(inner)], b))
            j += 1
    return np.array(faces)


def _membrane(
    faces: Int[np.ndarray, "t 3"], known: Float[np.ndarray, "n c"], count: int
) -> Float[np.ndarray, "k c"]:
    """Values at new vertices, each the mean of its neighbors', given those at the border.

    Args:
        faces: The cap: vertices of the border, then the new ones.
        known: Values at the border.
        count: Number of new vertices.
    """
    if count == 0:
        return np.zeros((0, known.shape[1]))
    border = len(known)
    ends = np.unique(np.sort(find_edges(faces).ends, axis=1), axis=0)
    rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
    size = border + count
    adjacency = scipy.sparse.csr_matrix(
        scipy.sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), (size, size))
    )
    inner = adjacency[border:]
    degree = np.asarray(inner.sum(axis=1)).reshape(-1)
    system = scipy.sparse.csr_matrix((degree, (range(count), range(count)))) - inner[:, border:]
    return scipy.sparse.linalg.splu(system.tocsc()).solve(inner[:, :border] @ known)


def _border_uv(mesh: Mesh, loop: Loop) -> Float[np.ndarray, "n 2"]:
    """Texture coordinates of the surface at each border vertex, from the adjacent face."""
    assert mesh.uv is not None
    end = loop.halves + np.where(loop.halves % 3 < 2, 1, -2)
    return mesh.uv.reshape(-1, 2)[end]


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


def _part(mesh: Mesh, face_part: Int[np.ndarray, " m"], index: int) -> Mesh:
    return drop_unused_vertices(keep_faces(mesh, face_part == index))


def _size(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def _lies_within(inner: Mesh, outer: Mesh) -> bool:
    """Return whether a surface lies within another one, whose open ends count as closed."""
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
