"""Voxel grid of a lumen: interior by ray parity, distance from the wall, handles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.geometry import triangle_areas, triangle_normals
from vrcaps.mesh.mesh import distinct_rows, find_edges

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_VOXELS = 30_000_000
_MAX_CROSSINGS = 50_000_000  # of triangle bounding boxes with grid lines: 10 GB
_COARSE_VOXELS = 1_000_000  # of the first pass, which measures volume and diameter


@dataclass(frozen=True)
class LumenGrid:
    """Voxels of a lumen; voxel (i, j, k) is centered at ``origin + voxel * (i, j, k)``.

    Attributes:
        inside: Whether the center of each voxel lies in the lumen.
        clearance: Distance of each voxel's center from the wall [m], to about half a voxel.
        origin: Center of voxel (0, 0, 0) [m].
        voxel: Edge length [m].
    """

    inside: Bool[np.ndarray, "x y z"]
    clearance: Float[np.ndarray, "x y z"]
    origin: Float[np.ndarray, " 3"]
    voxel: float

    def points(self, ids: Int[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Centers of voxels [m]."""
        return self.origin + self.voxel * np.asarray(ids, float)

    def clearance_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Interpolated distance from the wall at points [m]; 0 outside the lumen."""
        ids = (points - self.origin) / self.voxel
        return scipy.ndimage.map_coordinates(self.clearance, ids.T, order=1, mode="constant")


def voxelize(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], voxel: float
) -> LumenGrid:
    """Voxelize the lumen enclosed by a surface of any winding.

    A voxel is inside if a line from its center along z crosses the wall an odd number of times.
    Open ends are first closed by `close_ends`, so that this is defined everywhere. Voxels on
    either side of a sheet of tissue thinner than a voxel are not inside, so that no two inside
    neighbors are separated by the wall.

    Raises:
        InputError: If the grid would have more than `MAX_VOXELS` voxels.
    """
    vertices, faces = close_ends(vertices, faces)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shape = np.ceil((high - low) / voxel) + 3.0
    if shape.prod() > MAX_VOXELS:
        allowed = (np.prod(high - low) / MAX_VOXELS) ** (1 / 3)
        raise InputError(
            f"A voxel of {voxel:.3g} m makes a grid of {shape.prod():.2g} voxels. "
            f"Allowed: {MAX_VOXELS:.0e}. Use a voxel of at least {1.1 * allowed:.2g} m."
        )
    shape, origin = np.asarray(shape, int), low - voxel
    scaled = (vertices - origin) / voxel
    wall, sheet = np.zeros(shape, bool), np.zeros(shape, bool)
    inside = np.zeros(shape, np.uint8)
    for axes in ((1, 2, 0), (2, 0, 1), (0, 1, 2)):
        columns, _, height = grid_crossings(scaled[:, axes], faces, shape[list(axes)])
        # Views with the direction of the lines as the last axis.
        wall.transpose(axes)[(*columns.T, np.rint(height).astype(int))] = True
        above = np.ceil(height).astype(int)
        line = np.ravel_multi_index((*columns.T, above), tuple(shape[list(axes)]))
        line, count = np.unique(line, return_counts=True)
        column_x, column_y, above = np.unravel_index(line, tuple(shape[list(axes)]))
        if axes == (0, 1, 2):
            inside[column_x, column_y, above] = count & 1
        thin = count > 1
        for side in (above[thin], above[thin] - 1):
            sheet.transpose(axes)[column_x[thin], column_y[thin], side] = True
    np.bitwise_xor.accumulate(inside, axis=2, out=inside)
    inside = inside.astype(bool) & ~sheet
    clearance = np.asarray(scipy.ndimage.distance_transform_edt(~wall), np.float32)
    clearance = np.where(inside, np.maximum(clearance, 0.25), 0.0) * np.float32(voxel)
    return LumenGrid(inside, clearance, origin, voxel)


def close_ends(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, "l 3"]]:
    """Merge coincident vertices of a surface and close every open end by a cone.

    Edges with an odd number of faces form loops; each is joined to its centroid. Every line
    then crosses the surface an even number of times.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertices, inverse = distinct_rows(vertices)
    faces = inverse[faces]
    edges = find_edges(faces)
    rim = np.sort(edges.ends[edges.order[edges.first[edges.counts % 2 == 1]]], axis=1)
    rim = rim[rim[:, 0] != rim[:, 1]]
    if not len(rim):
        return vertices, faces
    n = len(vertices)
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(n, n))
    _, loop = connected_components(graph, directed=False)
    loops, which = np.unique(loop[rim[:, 0]], return_inverse=True)
    weight = np.bincount(which)
    middle = np.stack(
        [np.bincount(which, vertices[rim, axis].mean(axis=1)) / weight for axis in range(3)], axis=1
    )
    cones = np.column_stack([rim, n + which])
    assert len(loops) == len(middle)
    return np.concatenate([vertices, middle]), np.concatenate([faces, cones])


def num_pieces(faces: Int[np.ndarray, "m 3"]) -> int:
    """Number of pieces of a surface that share no vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = (faces.ravel(), np.roll(faces, -1, axis=1).ravel())
    n = int(faces.max()) + 1
    _, piece = connected_components(coo_array((np.ones(faces.size), links), shape=(n, n)))
    return len(np.unique(piece[faces]))


def grid_crossings(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], shape: Int[np.ndarray, " 3"]
) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Grid lines along z that intersect triangles, the triangles, and the heights.

    The test (an odd number of the triangle's edges lies to the right of the line) takes the
    lower vertex of each edge first, so that two triangles that share an edge never both miss or
    both hit a line through it.

    Args:
        vertices: Vertices in voxels, with grid lines at integer x and y.
        faces: Vertex indices of each triangle.
        shape: Shape of the grid.

    Raises:
        InputError: If the triangles are too many and too large for the memory.
    """
    corners = vertices[faces]
    first = np.ceil(corners[..., :2].min(axis=1)).astype(int)
    span = np.floor(corners[..., :2].max(axis=1)).astype(int) - first + 1
    count = np.maximum(span, 0).prod(axis=1)
    if count.sum() > _MAX_CROSSINGS:
        raise InputError(
            f"The triangles lie over {count.sum():.1g} grid lines, more than those of a wall. "
            "Their vertices are out of order. Export the mesh again."
        )
    face = np.repeat(np.arange(len(faces)), count)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    columns = first[face] + np.stack([rank // span[face, 1], rank % span[face, 1]], axis=1)
    hit = np.zeros(len(face), bool)
    for edge in ((0, 1), (1, 2), (2, 0)):
        pair = np.sort(faces[:, edge], axis=1)
        start, stop = vertices[pair[face, 0], :2], vertices[pair[face, 1], :2]
        spans = (start[:, 1] > columns[:, 1]) != (stop[:, 1] > columns[:, 1])
        rise = np.where(spans, stop[:, 1] - start[:, 1], 1.0)
        across = start[:, 0] + (columns[:, 1] - start[:, 1]) / rise * (stop[:, 0] - start[:, 0])
        hit ^= spans & (columns[:, 0] < across)
    columns, face = columns[hit], face[hit]
    corner = corners[face]
    normal = triangle_normals(corner)
    slope = np.where(normal[:, 2] != 0.0, normal[:, 2], 1.0)
    offset = columns - corner[:, 0, :2]
    height = corner[:, 0, 2] - (offset * normal[:, :2]).sum(axis=1) / slope
    height = np.clip(height, corner[..., 2].min(axis=1), corner[..., 2].max(axis=1))
    return columns, face, np.minimum(height, shape[2] - 1.0)


def mean_radius(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> float:
    """Twice the volume of the lumen over the area of its wall [m]: the radius of a long cylinder.

    Raises:
        InputError: If the surface encloses no lumen.
    """
    extent = np.ptp(vertices, axis=0)
    if not (len(faces) and np.isfinite(extent).all() and extent.min() > 0.0):
        raise InputError(f"The surface has extents {extent} m. Give one that encloses a lumen.")
    grid = voxelize(vertices, faces, (extent.prod() / _COARSE_VOXELS) ** (1 / 3))
    volume = np.count_nonzero(grid.inside) * grid.voxel**3
    area = triangle_areas(vertices[faces]).sum()
    if volume < 1e-3 * extent.prod() * 1e-3 or area <= 0.0:
        raise InputError("The surface encloses no lumen. Give a closed tube or pouch.")
    return 2.0 * volume / area


_APART = 5  # minimum distance between the centers of two chambers [voxels]
_DETOUR = 2.5  # path along the lumen, in chamber diameters, beyond which a contact is a short cut
_OFFSETS = [
    (i, j, k) for i in (0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)
]
"""Half of a voxel's 26 neighbors; symmetry covers the other half."""


def num_handles(faces: Int[np.ndarray, "m 3"]) -> int:
    """Number of handles of a closed surface, by Euler: V − E + F = 2 pieces − 2 handles."""
    euler = len(np.unique(faces)) - len(find_edges(faces).counts) + len(faces)
    return max(0, (2 * num_pieces(faces) - euler) // 2)


def without_short_cuts(grid: LumenGrid) -> tuple[LumenGrid, int]:
    """Close the short cuts between loops of a lumen, and count them.

    The lumen is divided into chambers around its widest points (a watershed of the distance from
    the wall). Their contacts form a graph; its maximum spanning tree by contact width is the
    course of the lumen, since it omits the narrowest contact of each cycle (Cormen et al.,
    Introduction to Algorithms, ch. 23). An omitted contact is closed if the path along the tree
    is long; a short one only goes around a fold.
    """
    watershed = import_extra("skimage.segmentation", "organs", package="scikit-image").watershed

    highest = scipy.ndimage.maximum_filter(grid.clearance, 2 * _APART + 1)
    peaks = np.empty(grid.inside.shape, np.int32)
    scipy.ndimage.label(grid.inside & (grid.clearance == highest), np.ones((3, 3, 3)), output=peaks)
    num = int(peaks.max())
    if num < 3:
        return grid, 0
    chamber = watershed(-grid.clearance, peaks, mask=grid.inside)
    voxels, key, width = _contacts(chamber, grid.clearance, num)
    pairs, first = np.unique(key, return_inverse=True)
    widest = np.zeros(len(pairs))
    np.maximum.at(widest, first, width)
    a, b = np.divmod(pairs, num + 1)
    middle = np.array(scipy.ndimage.center_of_mass(peaks > 0, peaks, np.arange(num + 1)[1:]))
    middle = np.vstack([np.full(3, np.nan), middle])
    shape = (num + 1, num + 1)
    tree = scipy.sparse.csgraph.minimum_spanning_tree(
        scipy.sparse.coo_array((1.0 / widest, (a, b)), shape=shape).tocsr()
    ).tocoo()
    step = np.linalg.norm(middle[tree.row] - middle[tree.col], axis=1) * grid.voxel
    way = scipy.sparse.csgraph.shortest_path(
        scipy.sparse.coo_array((step, (tree.row, tree.col)), shape=shape), directed=False
    )
    size = np.concatenate(
        [[0.0], scipy.ndimage.maximum(grid.clearance, peaks, np.arange(1, num + 1))]
    )
    is_cut = way[a, b] > 2.0 * _DETOUR * (size[a] + size[b])
    if not is_cut.any():
        return grid, 0
    closed = voxels[is_cut[first]]
    inside, clearance = grid.inside.copy(), grid.clearance.copy()
    inside.ravel()[closed], clearance.ravel()[closed] = False, 0.0
    return replace(grid, inside=inside, clearance=clearance), int(is_cut.sum())


def _contacts(
    chamber: Int[np.ndarray, "x y z"], clearance: Float[np.ndarray, "x y z"], num: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Voxels next to another chamber, of the lower index; key of the pair; and clearance there.

    The key of chambers a < b is a (num + 1) + b. The clearance is the minimum of both voxels.
    """
    label, clear = chamber.ravel(), clearance.ravel()
    ids = np.flatnonzero(label)
    _, ny, nz = chamber.shape
    contacts = []
    for i, j, k in _OFFSETS:
        neighbor = ids + (i * ny + j) * nz + k  # the grid's margin is outside
        other = label[neighbor]
        at = np.flatnonzero((other > 0) & (other != label[ids]))
        one, two = ids[at], neighbor[at]
        is_first = label[one] < label[two]
        low, high = np.where(is_first, one, two), np.where(is_first, two, one)
        key = label[low].astype(np.int64) * (num + 1) + label[high]
        contacts.append((low, key, np.minimum(clear[low], clear[high]).astype(float)))
    voxels, key, width = (np.concatenate(parts) for parts in zip(*contacts, strict=True))
    return voxels, key, width
