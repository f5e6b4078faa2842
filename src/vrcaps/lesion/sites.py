"""Lesion sites: wall extracted around a location, with coordinates for the lesion's shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps._core import Wall
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import edge_graph, wall_of
from vrcaps.core.units import MM
from vrcaps.lesion.base import Lesion, LesionSite, WallSamples
from vrcaps.lesion.mesh_patch import NUM_FIELDS, ExtractedPatch, extract, within
from vrcaps.lesion.placement import PlacedLesion, candidates, place_focal
from vrcaps.mesh.patch import Patch, log_map, refine
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.lesion.base import BloodFlow

_WAVY = 1.3  # maximum outline radius of a focal lesion, in mean radii
_STEP = 1.0 * MM  # along a flow of blood
_MIN_SLOPE = 0.10  # sine of the slope on which blood stops
_POOL_REACH = 40.0 * MM
_MARGIN = 6.0 * MM  # margin of wall around a flow and its pool


@dataclass(frozen=True)
class PlacementContext:
    """Wall and existing lesions for the placement of a new lesion.

    organ: Organ with the previous lesions.
        organ: With the lesions before it.
        wall: Same wall during modification.
        down: Unit vector of gravity, patient frame.
        num_vertices: Number of leading vertices that are the organ's own, evenly distributed.
        focal: Existing focal lesions.
    """

    organ: OrganSurface
    wall: Patch
    down: Float[np.ndarray, " 3"]
    num_vertices: int
    focal: list[PlacedLesion]

    def core(self) -> Wall:
        """Wall for ray and distance queries."""
        return wall_of(self.organ.vertices, self.organ.faces)


@dataclass(frozen=True)
class SitePatch:
    """Site of a lesion and the mesh patch around it.

    Attributes:
        site: Site data required by its form.
        piece: Wall extracted around it.
        patch: The piece with coordinates (`WallSamples.xy`) as its last fields.
        vertex: Vertex of the organ at its center.
    """

    site: LesionSite
    piece: ExtractedPatch
    patch: Patch
    vertex: int


def focal_site(lesion: Lesion, context: PlacementContext, rng: np.random.Generator) -> SitePatch:
    """Wall around a center, with its geodesic log map.

    Args:
        lesion: Lesion to place.
        context: Wall and existing lesions.
        rng: Draws the unspecified values of the location.

    Raises:
        InputError: If the lesion does not fit anywhere.
    """
    placed = place_focal(
        context.organ,
        context.core(),
        lesion,
        context.focal,
        rng,
        num_vertices=context.num_vertices,
    )
    radius = lesion.footprint_radius * _WAVY
    reach = 1.5 * radius + 5.0 * MM
    piece = extract(context.wall, within(context.wall, np.array([placed.vertex]), reach))
    patch = _evenly_refined(piece.patch, 1.3 * radius, _even_length(radius))
    center = int(np.searchsorted(piece.vertices, placed.vertex))
    xy, axes = log_map(patch, center, radius=radius, edge_length=_even_length(radius))
    site = LesionSite(placed.center, axes, context.down)
    return SitePatch(site, piece, _with_columns(patch, xy), placed.vertex)


def circumferential_site(
    lesion: Lesion, context: PlacementContext, rng: np.random.Generator
) -> SitePatch:
    """Wall between two arc lengths.

    Args:
        lesion: Lesion to place.
        context: Wall and existing lesions.
        rng: Draws the unspecified values of the location.

    Raises:
        InputError: If there is no wall in the range.
    """
    organ = context.organ
    low, high, vertex = _find_range(lesion, context, rng)
    arc_length = organ.arc_length
    outside = np.maximum(low - arc_length, arc_length - high)
    piece = extract(context.wall, np.where(outside < 15.0 * MM, outside, np.inf))
    xy = np.stack([piece.patch.fields[:, 0], np.zeros(len(piece.vertices))], axis=1)
    site = LesionSite(organ.vertices[vertex], np.eye(3), context.down, arc_length_range=(low, high))
    return SitePatch(site, piece, _with_columns(piece.patch, xy), vertex)


def _find_range(
    lesion: Lesion, context: PlacementContext, rng: np.random.Generator
) -> tuple[float, float, int]:
    """First and last arc length [m], and a vertex in the middle of the range."""
    organ, location = context.organ, lesion.location
    middle, reason = None, None
    drawn = candidates(organ, location, rng, context.num_vertices)
    for vertex in drawn:
        if location.segment is not None or location.arc_length is not None or reason is not None:
            middle = float(organ.arc_length[vertex])
            middle = middle if location.arc_length is None else location.arc_length
        try:
            low, high = lesion.arc_length_range(organ, middle)
        except InputError as error:
            reason = error
            continue
        own = np.clip((low, high), 0.0, organ.centerline.length)
        away = np.abs(organ.arc_length[: context.num_vertices] - own.mean())
        return low, high, int(np.argmin(away))
    assert reason is not None
    raise reason


def flow_site(lesion: Lesion, context: PlacementContext, rng: np.random.Generator) -> SitePatch:
    """Wall along the path of blood from its source to the point where it collects.

    Args:
        lesion: Lesion to place.
        context: Wall and existing lesions.
        rng: Draws the unspecified values of the location, and meanders.
    """
    organ, core = context.organ, context.core()
    best: tuple[int, np.ndarray] | None = None
    for vertex in candidates(organ, lesion.location, rng, context.num_vertices):
        path = trace_down(core, organ.vertices[vertex], context.down, lesion.flow.run, rng)
        if best is None or len(path) > len(best[1]):
            best = (vertex, path)
        if len(path) * _STEP > 0.6 * lesion.flow.run:
            break
    assert best is not None
    vertex, path = best
    return _along_path(lesion.flow, context, vertex, path)


def _along_path(
    flow: BloodFlow,
    context: PlacementContext,
    vertex: int,
    path: Float[np.ndarray, "k 3"],
) -> SitePatch:
    """Wall along a flow's path and in the hollow at its end."""
    wall, organ = context.wall, context.organ
    reach = 8.0 * flow.width + 2.0 * flow.source
    along = np.asarray(scipy.spatial.KDTree(organ.vertices).query(path)[1])
    distance = within(wall, np.unique(along), reach + _MARGIN)
    beyond = np.full(len(distance), np.inf)
    if flow.pool > 0.0:
        beyond = within(wall, _hollow(context, along[-1], flow.pool), _MARGIN)
    is_pool = np.isfinite(beyond) & ~np.isfinite(distance)
    piece = extract(wall, np.where(is_pool, reach, distance))
    far = np.column_stack([distance, beyond])[piece.vertices]
    patch = _with_columns(piece.patch, np.minimum(far, [reach + _MARGIN, _MARGIN]))
    patch = _evenly_refined(patch, 3.0 * flow.width, min(0.8 * MM, 0.6 * flow.width))
    dense = np.linspace(0.0, len(path) - 1.0, 8 * len(path))
    line = np.stack([np.interp(dense, np.arange(len(path)), p) for p in path.T], axis=1)
    away, nearest = scipy.spatial.KDTree(line).query(patch.moved)
    distance, beyond = patch.fields[:, NUM_FIELDS:].T
    away = np.where(distance < 0.95 * reach, away, np.maximum(away, reach))
    xy = np.stack([nearest / 8.0 * _STEP, away, beyond], axis=1)
    patch = _with_columns(replace(patch, fields=patch.fields[:, :NUM_FIELDS]), xy)
    site = LesionSite(
        center=path[0],
        axes=np.eye(3),
        down=context.down,
        bottom=path[-1],
        reach=_POOL_REACH,
    )
    return SitePatch(site, piece, patch, vertex)


def _hollow(context: PlacementContext, bottom: int, deep: float) -> Int[np.ndarray, " k"]:
    """Vertices below a pool's level that are connected to its bottom below that level."""
    vertices = context.wall.moved
    under = (vertices - vertices[bottom]) @ context.down > -deep
    near = np.linalg.norm(vertices - vertices[bottom], axis=1) < _POOL_REACH
    wet = np.flatnonzero(under & near)
    graph = edge_graph(context.wall.moved, context.wall.faces).tocsr()[wet][:, wet]
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return wet[part == part[np.searchsorted(wet, bottom)]]


def trace_down(
    core: Wall,
    start: Float[np.ndarray, " 3"],
    down: Float[np.ndarray, " 3"],
    length: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "k 3"]:
    """Meandering path of a drop down the wall in steps of 1 mm; ends where the wall is level.

    Args:
        core: The wall.
        start: Source of the blood [m].
        down: Unit vector of gravity.
        length: Maximum path length [m].
        rng: Draws the meanders.
    """
    points, sway = [np.asarray(start, float)], 0.0
    for _ in range(int(length / _STEP)):
        here = points[-1]
        ahead, _ = core.closest_point((here + 0.5 * _STEP * down)[None])
        fall = ahead[0] - here
        slope = np.linalg.norm(fall) / (0.5 * _STEP)
        if slope < _MIN_SLOPE:
            break
        fall /= np.linalg.norm(fall)
        sway = 0.9 * sway + rng.normal(0.0, 0.12)
        side = np.cross(fall, here + down - ahead[0])
        side /= max(float(np.linalg.norm(side)), 1e-12)
        step = fall + np.clip(sway, -0.6, 0.6) * side
        step *= _STEP / np.linalg.norm(step)
        points.append(core.closest_point((here + step)[None])[0][0])
    return np.array(points)


SITES: dict[str, Callable[[Lesion, PlacementContext, np.random.Generator], SitePatch]] = {
    "focal": focal_site,
    "circumferential": circumferential_site,
    "flow": flow_site,
}
"""Site function of each extent."""


def _even_length(radius: float) -> float:
    """Maximum edge length [m] for an accurate log map of a focal lesion."""
    return float(np.clip(radius / 9.0, 0.12 * MM, 1.0 * MM))


def _with_columns(patch: Patch, columns: Float[np.ndarray, "n k"]) -> Patch:
    return replace(patch, fields=np.column_stack([patch.fields, columns]))


def _evenly_refined(patch: Patch, reach: float, longest: float) -> Patch:
    """Piece with short edges up to the distance `reach` from its center along the wall."""

    def is_long(patch: Patch, ends: np.ndarray) -> np.ndarray:
        near = patch.fields[ends, NUM_FIELDS - 1].min(axis=1) < reach
        p = patch.moved[ends]
        return near & (np.linalg.norm(p[:, 0] - p[:, 1], axis=1) > longest)

    return refine(patch, is_long, lambda patch: patch.moved)


def samples(patch: Patch) -> WallSamples:
    """Vertices of a piece with coordinates, as samples."""
    return WallSamples(
        xy=patch.fields[:, NUM_FIELDS:],
        rest=patch.moved,
        normal=patch.normals,
        inward=patch.fields[:, 2:5],
    )
