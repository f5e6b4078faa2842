"""Texture coordinates of a wall: tube coordinates where possible, else an atlas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas, triangle_normals, unit
from vrcaps.mesh.mesh import Mesh, find_edges
from vrcaps.organ.lumen_grid import grid_crossings

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_STRETCH = 2.0  # maximum ratio of the tube's texel length to its median, at p1 and p99
_RESOLUTION = 2048  # texels per side for which the atlas is packed
_PADDING = 4  # texels between charts at that resolution
_CHART_FRACTION = 0.02  # maximum part of the wall in one chart; large charts are slow to flatten
_SHARP = 0.5  # cosine of the angle between faces, below which no chart spans their edge
_MAX_WORK = 6e8  # sharp edges times faces, proportional to time: about 1.5 minutes
_CHART_COST = 1.0  # maximum distortion of a growing chart (xatlas metric; its default is 2)


def texture_coordinates(
    mesh: Mesh,
    arc_length: Float[np.ndarray, " n"],
    theta: Float[np.ndarray, " n"],
    radius: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "m 3 2"]:
    """Texture coordinates of each corner of each face, without overlap.

    `tube_coordinates` are used if they fold no face and stretch none much: u around the gut
    (beyond 1 on faces across ±π, where the texture wraps), v along it. Otherwise the wall is cut
    into flat charts, packed without overlap in the unit square by `atlas_coordinates`.

    Args:
        mesh: The wall [m]; faces counter-clockwise as seen from the lumen.
        arc_length: Gut coordinate of each vertex [m].
        theta: Gut coordinate of each vertex [rad].
        radius: Distance of each vertex from the centerline [m].

    Raises:
        InputError: If a face has zero area.
    """
    vertices, faces = np.asarray(mesh.vertices, float), mesh.faces
    flat = np.flatnonzero(triangle_areas(vertices[faces]) <= 0.0)
    if len(flat):
        raise InputError(
            f"Face {flat[0]} and {len(flat) - 1} others have no area. Repair the mesh."
        )
    tube = tube_coordinates(faces, arc_length, theta)
    span = np.array([2.0 * np.pi * np.median(radius), np.ptp(arc_length)])
    stretch = texture_stretch(vertices[faces], tube * span)
    low, middle, high = np.percentile(stretch, [1.0, 50.0, 99.0])
    if stretch.min() > 0.0 and high < _STRETCH * middle and low > middle / _STRETCH:
        return tube
    return atlas_coordinates(vertices, faces)


def tube_coordinates(
    faces: Int[np.ndarray, "m 3"],
    arc_length: Float[np.ndarray, " n"],
    theta: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "m 3 2"]:
    """Tube coordinates: u = ½ − θ / 2π around the gut (0 to 1.5), v = fraction of arc length.

    Only faces across ±π extend beyond u = 1. Seen from the lumen, textures are not mirrored.
    """
    u = 0.5 - theta[faces] / (2.0 * np.pi)
    u = u - np.rint(u - u[:, :1])
    u = u - np.floor(u.min(axis=1, keepdims=True))
    start = arc_length.min()
    v = (arc_length[faces] - start) / max(float(np.ptp(arc_length)), np.finfo(float).tiny)
    return np.stack([u, v], axis=-1)


def texture_stretch(
    corners: Float[np.ndarray, "m 3 3"], uv: Float[np.ndarray, "m 3 2"]
) -> Float[np.ndarray, "m 2"]:
    """Singular values of each face's map to texture space, the smaller negative if mirrored.

    Args:
        corners: Corners of each face [m].
        uv: Texture coordinates of each corner of each face.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    along = (first * second).sum(axis=1) / length
    across = np.linalg.norm(np.cross(first, second), axis=1) / length
    du = (uv[:, 1] - uv[:, 0]) / length[:, None]
    dv = (uv[:, 2] - uv[:, 0] - along[:, None] * du) / across[:, None]
    # Singular values of a 2×2 matrix are |p| ± |q| of its rotating and mirroring parts.
    turn = np.hypot(du[:, 0] + dv[:, 1], du[:, 1] - dv[:, 0])
    mirror = np.hypot(du[:, 0] - dv[:, 1], du[:, 1] + dv[:, 0])
    return 0.5 * np.stack([turn - mirror, turn + mirror], axis=1)


def tangent_lengths(
    corners: Float[np.ndarray, "m 3 3"], uv: Float[np.ndarray, "m 3 2"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Lengths of the derivatives of position by u and by v on each face, times its determinant [m].

    The determinant is that of the edges in texture space. The gradients of u and v have the lengths
    of the other derivative times the determinant, over twice the face's area.

    Args:
        corners: Corners of each face [m].
        uv: Texture coordinates of each corner of each face.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (du1, dv1), (du2, dv2) = np.moveaxis(uv[:, 1:] - uv[:, :1], 0, -1)
    along_u = np.linalg.norm(first * dv2[:, None] - second * dv1[:, None], axis=1)
    along_v = np.linalg.norm(second * du1[:, None] - first * du2[:, None], axis=1)
    return along_u, along_v


def atlas_coordinates(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 3 2"]:
    """Charts of low distortion and even texel density, packed without overlap in the unit square.

    Parts of a chart that overlap become separate charts, mirrored charts are flipped, then all
    charts are packed again.

    Raises:
        InputError: If the faces are so irregular that charts would take minutes.
    """
    import xatlas

    _require_smooth(vertices, faces)
    scale = float(np.sqrt(triangle_areas(vertices[faces]).sum()))
    scaled = (vertices - vertices.min(axis=0)) / scale
    atlas = xatlas.Atlas()
    atlas.add_mesh(scaled.astype(np.float32), faces.astype(np.uint32))
    charts = xatlas.ChartOptions()
    charts.max_cost = _CHART_COST
    charts.max_chart_area = _CHART_FRACTION
    atlas.generate(charts, _pack_options())
    _, index, uv = atlas[0]
    uv = np.asarray(uv, float) * (atlas.width, atlas.height)
    uv, index = _unfolded(uv, index.astype(int))
    uv = _unmirrored(uv, index)
    packed = xatlas.Atlas()
    packed.add_uv_mesh(uv.astype(np.float32), index.astype(np.uint32))
    packed.generate(xatlas.ChartOptions(), _pack_options())
    _, index, uv = packed[0]
    size = np.array([packed.width, packed.height], float)
    return (np.asarray(uv, float) * size / size.max())[index]


def _require_smooth(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> None:
    """Reject a wall with so many sharp edges that nearly every face would be a separate chart.

    Raises:
        InputError: If the work would exceed `_MAX_WORK`.
    """
    edges = find_edges(faces)
    normals = unit(triangle_normals(vertices[faces]))
    one, other = (edges.with_count(2) // 3).T
    num_smooth = np.count_nonzero((normals[one] * normals[other]).sum(axis=1) > _SHARP)
    num_sharp = len(edges.counts) - num_smooth
    if num_sharp * len(faces) > _MAX_WORK:
        raise InputError(
            f"{num_sharp} of the wall's {len(edges.counts)} edges turn by more than 60° or are "
            f"open: with {len(faces)} faces, texture charts would take minutes. Allowed: up to "
            f"{_MAX_WORK / len(faces):.0f} such edges. Smooth the wall, or give it fewer faces."
        )


def _pack_options():
    """Packing options: reproducible, no chart mirrored, room for filtering."""
    import xatlas

    options = xatlas.PackOptions()
    options.resolution = _RESOLUTION
    options.padding = _PADDING
    options.bilinear = True
    options.rotate_charts = False  # swaps axes, which mirrors
    options.rotate_charts_to_axis = True
    return options


def _unfolded(
    uv: Float[np.ndarray, "k 2"], index: Int[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "l 2"], Int[np.ndarray, "m 3"]]:
    """Coordinates [texels] and corners with doubly covered patches moved outside the atlas.

    Of two overlapping patches, the one with fewer faces is moved, with u beyond the atlas.
    """
    moved = _smaller_of_doubles(uv, index)
    if not moved:
        return uv, index
    beyond = 2.0 * (np.ptp(uv[:, 0]) + 1.0)
    faces = np.concatenate(moved)
    patch_id = np.repeat(np.arange(1, len(moved) + 1), [len(patch) for patch in moved])
    # Each patch gets separate vertices.
    keys, local = np.unique(patch_id[:, None] * len(uv) + index[faces], return_inverse=True)
    index = index.copy()
    index[faces] = len(uv) + local.reshape(-1, 3)
    shift = np.stack([keys // len(uv) * beyond, np.zeros(len(keys))], axis=1)
    return np.concatenate([uv, uv[keys % len(uv)] + shift]), index


def _smaller_of_doubles(
    uv: Float[np.ndarray, "k 2"], index: Int[np.ndarray, "m 3"]
) -> list[Int[np.ndarray, " p"]]:
    """Faces of each patch to move so that no center of 2×2 texels is covered twice."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    points = np.column_stack([0.5 * (uv - uv.min(axis=0)), np.zeros(len(uv))])
    width = int(points.max()) + 2
    columns, face, _ = grid_crossings(points, index, np.array([width, width, 2]))
    texel = columns[:, 0] * width + columns[:, 1]
    double = np.bincount(texel)[texel] > 1
    texel, face = texel[double], face[double]
    faces = np.unique(face)
    links = (np.repeat(np.arange(len(faces)), 3), index[faces].ravel())
    touch = coo_array((np.ones(3 * len(faces)), links), shape=(len(faces), len(uv))).tocsr()
    count, patch = connected_components(touch @ touch.T >= 2.0)
    # Texels of each patch, and how often each is covered by remaining patches.
    patch_of = patch[np.searchsorted(faces, face)]
    texel = np.unique(texel, return_inverse=True)[1]
    covered = np.bincount(texel)
    num_double = np.count_nonzero(covered > 1)
    parts = np.split(
        texel[np.argsort(patch_of, kind="stable")], np.cumsum(np.bincount(patch_of))[:-1]
    )
    members = np.split(faces[np.argsort(patch, kind="stable")], np.cumsum(np.bincount(patch))[:-1])
    moved = []
    for patch_id in np.argsort(np.bincount(patch, minlength=count), kind="stable"):
        if num_double == 0:
            break
        moved.append(members[patch_id])
        own, times = np.unique(parts[patch_id], return_counts=True)
        before = np.count_nonzero(covered[own] > 1)
        covered[own] -= times
        num_double -= before - np.count_nonzero(covered[own] > 1)
    return moved


def _unmirrored(
    uv: Float[np.ndarray, "k 2"], index: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "k 2"]:
    """Coordinates with mirrored charts flipped into the empty region u < 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(uv)
    links = (index.ravel(), np.roll(index, -1, axis=1).ravel())
    _, chart = connected_components(coo_array((np.ones(index.size), links), shape=(n, n)))
    area = np.bincount(chart[index[:, 0]], _signed_areas(uv[index]))
    mirrored = area[chart] < 0.0
    return np.stack([np.where(mirrored, -1.0 - uv[:, 0], uv[:, 0]), uv[:, 1]], axis=1)


def _signed_areas(uv: Float[np.ndarray, "m 3 2"]) -> Float[np.ndarray, " m"]:
    """Area of each face, positive if counter-clockwise."""
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
