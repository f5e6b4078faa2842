"""Wall patches: conforming refinement, and the geodesic log map about a center.

Rivara 1984, "Algorithms for refining triangular grids suitable for adaptive and multigrid
techniques", Int. J. Numer. Meth. Eng. 20:745. Angles stay above half the initial minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.geometry import unit
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import find_edges, vertex_normals

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


_MAX_ROUNDS = 60
_SHORTEST = 0.01 * MM  # minimum length of an edge that is still split


@dataclass(frozen=True)
class Patch:
    """Mesh patch under refinement, with its own vertex and face indices.

    Attributes:
        clean: Positions without lesions [m].
        moved: Positions with the lesions so far [m].
        normals: Unit normals of the moved wall.
        clean_normals: Unit normals of the clean wall.
        theta: Angle around the centerline [rad].
        fields: Other quantities that are linear along edges, one row per vertex.
        label: Segment of each vertex.
        instance: Lesion ID of each vertex.
        faces: Vertex indices.
        uv: Texture coordinates of each corner.
        chart_id: Chart of each face's coordinates.
        is_rim: Whether a vertex lies on the cut through the wall.
    """

    clean: Float[np.ndarray, "n 3"]
    moved: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    clean_normals: Float[np.ndarray, "n 3"]
    theta: Float[np.ndarray, " n"]
    fields: Float[np.ndarray, "n k"]
    label: Int[np.ndarray, " n"]
    instance: Int[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]
    uv: Float[np.ndarray, "m 3 4"]
    chart_id: Int[np.ndarray, " m"]
    is_rim: Bool[np.ndarray, " n"]


def refine(
    patch: Patch,
    is_long: Callable[[Patch, Int[np.ndarray, "e 2"]], Bool[np.ndarray, " e"]],
    positions: Callable[[Patch], Float[np.ndarray, "n k"]],
) -> Patch:
    """Bisect edges until none away from the rim is too long; rim edges are not split.

    Args:
        patch: Patch to refine.
        is_long: Function that selects the edges to split.
        positions: Positions for comparing edge lengths, the longest edge of a face being split
            first: at rest, or at rest and with the lesion. With it alone, a short edge may span
            a bulge, and its neighbors would be split endlessly.
    """
    for _ in range(_MAX_ROUNDS):
        ends, of_face = _edges(patch.faces)
        marked = is_long(patch, ends) & ~patch.is_rim[ends].any(axis=1)
        points = positions(patch)
        length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        marked &= length > _SHORTEST
        if not marked.any():
            break
        length = length * (1.0 + 1e-9 * np.arange(len(length)) / len(length))
        length[patch.is_rim[ends].all(axis=1)] = 0.0
        longest = of_face[np.arange(len(of_face)), np.argmax(length[of_face], axis=1)]
        marked = _closed(marked, of_face, longest)
        patch = _split(patch, ends, of_face, longest, marked)
    return patch


def _edges(
    faces: Int[np.ndarray, "m 3"],
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "m 3"]]:
    """Ends of each edge, and the edges of each face: corner k to k + 1."""
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)
    key = pairs[..., 0].astype(np.int64) * (faces.max() + 1) + pairs[..., 1]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return pairs.reshape(-1, 2)[first], inverse.reshape(faces.shape)


def _closed(
    marked: Bool[np.ndarray, " e"],
    of_face: Int[np.ndarray, "m 3"],
    longest: Int[np.ndarray, " m"],
) -> Bool[np.ndarray, " e"]:
    """Marks extended by the longest edge of every marked face."""
    marked = marked.copy()
    while True:
        wanted = longest[marked[of_face].any(axis=1)]
        if marked[wanted].all():
            return marked
        marked[wanted] = True


def _split(
    patch: Patch,
    ends: Int[np.ndarray, "e 2"],
    of_face: Int[np.ndarray, "m 3"],
    longest: Int[np.ndarray, " m"],
    marked: Bool[np.ndarray, " e"],
) -> Patch:
    """Bisect the marked edges; each face is cut at its longest edge first."""
    new_index = np.full(len(ends), -1)
    new_index[marked] = len(patch.clean) + np.arange(marked.sum())
    patch = _with_midpoints(patch, ends[marked])
    affected = marked[of_face].any(axis=1)
    first = np.argmax(of_face == longest[:, None], axis=1)
    order = (first[:, None] + np.arange(3)) % 3
    rows = np.arange(len(order))[:, None]
    f, e, uv = patch.faces[rows, order], of_face[rows, order], patch.uv[rows, order]
    faces, uvs, charts = (
        [patch.faces[~affected]],
        [patch.uv[~affected]],
        [patch.chart_id[~affected]],
    )
    f, e, uv, chart = f[affected], e[affected], uv[affected], patch.chart_id[affected]
    middle, middle_uv = new_index[e[:, 0]], 0.5 * (uv[:, 0] + uv[:, 1])
    # The halves are (c, a, m) and (b, c, m); the edges c–a and b–c may be split too.
    for a, b, edge in ((2, 0, 2), (1, 2, 1)):
        half = np.stack([f[:, a], f[:, b], middle], axis=1)
        half_uv = np.stack([uv[:, a], uv[:, b], middle_uv], axis=1)
        cut = new_index[e[:, edge]] >= 0
        faces.append(half[~cut])
        uvs.append(half_uv[~cut])
        charts.append(chart[~cut])
        new, new_uv = new_index[e[cut, edge]], 0.5 * (half_uv[cut, 0] + half_uv[cut, 1])
        for first in (True, False):
            corners = (half[cut, 0], new) if first else (new, half[cut, 1])
            corner_uv = (half_uv[cut, 0], new_uv) if first else (new_uv, half_uv[cut, 1])
            faces.append(np.stack([*corners, middle[cut]], axis=1))
            uvs.append(np.stack([*corner_uv, middle_uv[cut]], axis=1))
            charts.append(chart[cut])
    return replace(
        patch,
        faces=np.concatenate(faces),
        uv=np.concatenate(uvs),
        chart_id=np.concatenate(charts),
    )


def _with_midpoints(patch: Patch, ends: Int[np.ndarray, "k 2"]) -> Patch:
    """Patch with a vertex at the middle of each given edge, not yet in any face."""
    a, b = ends.T
    clean, clean_normals = _curved_middle(patch.clean, patch.clean_normals, ends)
    moved, normals = _curved_middle(patch.moved, patch.normals, ends)
    delta = (patch.theta[b] - patch.theta[a] + np.pi) % (2.0 * np.pi) - np.pi
    theta = (patch.theta[a] + 0.5 * delta + np.pi) % (2.0 * np.pi) - np.pi
    both = np.where(patch.instance[a] == patch.instance[b], patch.instance[a], 0)
    return replace(
        patch,
        clean=np.concatenate([patch.clean, clean]),
        moved=np.concatenate([patch.moved, moved]),
        normals=np.concatenate([patch.normals, normals]),
        clean_normals=np.concatenate([patch.clean_normals, clean_normals]),
        theta=np.concatenate([patch.theta, theta]),
        fields=np.concatenate([patch.fields, 0.5 * (patch.fields[a] + patch.fields[b])]),
        label=np.concatenate([patch.label, patch.label[a]]),
        instance=np.concatenate([patch.instance, both]),
        is_rim=np.concatenate([patch.is_rim, np.zeros(len(a), bool)]),
    )


def _curved_middle(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    ends: Int[np.ndarray, "k 2"],
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Middle of the cubic edge of a PN triangle (Vlachos et al. 2001), and the mean normal.

    Their quadratic normals would oscillate increasingly under repeated bisection.
    """
    (p, q), (n, m) = (points[ends[:, k]] for k in (0, 1)), (normals[ends[:, k]] for k in (0, 1))
    d = q - p
    along_n, along_m = (d * n).sum(axis=1, keepdims=True), (d * m).sum(axis=1, keepdims=True)
    middle = 0.5 * (p + q) + (along_m * m - along_n * n) / 8.0
    normal = n + m
    return middle, unit(normal)


def rim(faces: Int[np.ndarray, "m 3"], num_vertices: int) -> Bool[np.ndarray, " n"]:
    """Vertices at boundary edges, which have a single face."""
    edges = find_edges(faces)
    single = edges.with_count(1)
    flags = np.zeros(num_vertices, bool)
    flags[np.asarray(edges.ends)[single].ravel()] = True
    return flags


def renewed_normals(patch: Patch) -> Patch:
    """Patch with normals recomputed from its moved faces, except on its rim."""
    normals = vertex_normals(patch.moved, patch.faces)
    return replace(patch, normals=np.where(patch.is_rim[:, None], patch.normals, normals))


class ThinTrianglesError(InputError):
    """Error for a piece of wall with needle triangles, on which there is no log map."""


_BEYOND = 1.05  # radii up to which distances are exact


def log_map(
    patch: Patch, center: int, *, radius: float, edge_length: float
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "3 3"]]:
    """Geodesic log map of a piece of wall about a vertex, and axes at that vertex.

    Directions by the vector heat method (Sharp, Soliman and Crane 2019, ACM Trans. Graph. 38:24),
    distances within the radius along geodesics by edge flips (Sharp and Crane 2020, ACM Trans.
    Graph. 39:249).

    Args:
        patch: Piece of wall.
        center: Index of the vertex.
        radius: Radius within which distances are exact [m].
        edge_length: Edge length of the triangles around it [m].

    Returns:
        Log map of every vertex [m]; columns x, y and normal, patient frame.

    Raises:
        MissingExtraError: If potpourri3d is not installed.
        ThinTrianglesError: If triangles in the patch are needles.
    """
    solver, xy = _vector_heat(patch, center, edge_length)
    x, y, normal = (np.asarray(axis)[center] for axis in solver.get_tangent_frames())
    rho = np.linalg.norm(xy, axis=1)
    near = np.flatnonzero((rho < _BEYOND * radius) & (np.arange(len(rho)) != center) & (rho > 0.0))
    exact = _path_lengths(patch, center, near)
    xy[near] *= (exact / rho[near])[:, None]
    xy[center] = 0.0
    return xy, np.stack([x, y, normal], axis=1)


def _vector_heat(
    patch: Patch, center: int, edge_length: float
) -> tuple[Any, Float[np.ndarray, "n 2"]]:
    """Solver with tangent frames, and log map of every vertex [m]."""
    pp3d = import_extra("potpourri3d", "lesions")
    corners = patch.moved[patch.faces]
    mean_edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    # Diffusion time t = coefficient · (mean edge)²; fine meshes of other lesions would stop it.
    time = (edge_length / mean_edge) ** 2
    for is_delaunay, factor in ((True, 1.0), (False, 1.0), (True, 6.0)):
        try:
            solver = pp3d.MeshVectorHeatSolver(patch.moved, patch.faces, factor * time, is_delaunay)
            xy = np.asarray(solver.compute_log_map(center))
        except RuntimeError:  # its matrix is singular if triangles are needles
            continue
        if np.isfinite(xy).all():
            return solver, xy
    x, y, z = patch.moved[center] / MM
    raise ThinTrianglesError(
        f"the wall at ({x:.1f}, {y:.1f}, {z:.1f}) mm has triangles that are too thin for a lesion"
    )


def _path_lengths(
    patch: Patch, center: int, targets: Int[np.ndarray, " k"]
) -> Float[np.ndarray, " k"]:
    """Lengths [m] of geodesics from the center."""
    import potpourri3d as pp3d

    solver = pp3d.EdgeFlipGeodesicSolver(patch.moved, patch.faces)
    paths = (solver.find_geodesic_path(center, int(target)) for target in targets)
    return np.array([np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths])
