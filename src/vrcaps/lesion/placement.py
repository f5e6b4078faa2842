"""Placement of lesions: at a given location, or drawn until they fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import CM, MM
from vrcaps.lesion.base import Lesion, Location, SizedLesion

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.organ.surface import OrganSurface

_NUM_TRIES = 60
_GAP = 2.0 * MM  # between the footprints of two lesions
_MAX_FILL = 0.8  # fraction of the free distance across the lumen that a lesion may take
_BESIDE = 1.05  # clearance around a protrusion in the lumen, in its radii
_MAX_FOOTPRINT = 1.3  # maximum footprint radius for a valid log map, in radii of the lumen
_BEHIND = 0.3 * MM
_BULGE = 1.5  # of the diameter between folds, an upper bound of the lumen from wall to wall
_SIZE_STEP = 0.5 * MM  # step of the maximum size that fits
_UNEVEN = 0.35  # maximum wall unevenness around a pouch, in radii of its footprint


@dataclass(frozen=True)
class PlacedLesion:
    """Lesion and the wall vertex at its center.

    Attributes:
        lesion: Specification of the lesion.
        vertex: Vertex index in the organ before the lesion.
        center: Position [m].
    """

    lesion: Lesion
    vertex: int
    center: Float[np.ndarray, " 3"]


def place_focal(
    organ: OrganSurface,
    wall: Wall,
    lesion: Lesion,
    others: list[PlacedLesion],
    rng: np.random.Generator,
    *,
    num_vertices: int,
) -> PlacedLesion:
    """Find a wall position for a focal lesion: at its location, or anywhere that it fits.

    Args:
        organ: Organ without it.
        wall: Wall of the organ, for clearance.
        lesion: Lesion to place.
        others: Lesions placed earlier, which it must not touch.
        rng: Draws the unspecified values of the location.
        num_vertices: Number of leading vertices that are evenly distributed over the wall.

    Raises:
        InputError: If it does not fit there, or in none of the tries; the message gives the largest
            size of its kind that does.
        UnknownNameError: If the organ has no such segment.
    """
    vertices, reason = [], ""
    for vertex in candidates(organ, lesion.location, rng, num_vertices):
        vertices.append(vertex)
        reason = _misfit(organ, wall, lesion, others, vertex)
        if not reason:
            return PlacedLesion(lesion, vertex, organ.vertices[vertex])
    is_one = len(vertices) == 1
    drawn = "" if is_one else f"none of {len(vertices)} locations drawn will do; at the last, "
    size = _largest_size(organ, wall, lesion, others, vertices)
    largest = f" Largest size that fits there: {size / MM:.1f} mm."
    raise InputError(
        f"No location for {describe(lesion)}: {drawn}{reason}.{largest if size else ''}"
    )


def require_locations(
    organ: OrganSurface, wall: Wall, lesions: Sequence[Lesion], rngs: Sequence[np.random.Generator]
) -> None:
    """Check that each focal lesion fits in a healthy organ, before any is added.

    Args:
        organ: Organ without lesions.
        wall: Wall of the organ, for clearance.
        lesions: Lesions to place.
        rngs: Random generator of each; its state is unchanged.

    Raises:
        InputError: As `place_focal`.
        UnknownNameError: As `place_focal`.
    """
    for lesion, rng in zip(lesions, rngs, strict=True):
        if lesion.extent == "focal":
            count = len(organ.vertices)
            place_focal(organ, wall, lesion, [], deepcopy(rng), num_vertices=count)


def _largest_size(
    organ: OrganSurface,
    wall: Wall,
    lesion: Lesion,
    others: list[PlacedLesion],
    vertices: list[int],
) -> float:
    """Maximum size [m] of a lesion of that kind that fits at one of some vertices; 0 if none."""

    def fits(smaller: Lesion) -> bool:
        return any(not _misfit(organ, wall, smaller, others, vertex) for vertex in vertices)

    return next((smaller.size for smaller in _smaller(lesion) if fits(smaller)), 0.0)


def _smaller(lesion: Lesion) -> Iterator[SizedLesion]:
    """Same lesion in all smaller sizes allowed by its kind, in descending order."""
    if not isinstance(lesion, SizedLesion):
        return
    for step in range(math.floor(lesion.size / _SIZE_STEP), 0, -1):
        try:
            smaller = replace(lesion, size=step * _SIZE_STEP)
        except InputError:  # below the minimum of its kind
            return
        yield smaller


def require_possible(lesions: Sequence[Lesion], diameter: float) -> None:
    """Check focal lesions against the maximum width of a lumen before it is generated.

    Args:
        lesions: Lesions to place.
        diameter: Maximum diameter of the lumen [m], from its generation parameters.

    Raises:
        InputError: If one is too large; the message gives the maximum size that may fit.
    """

    def is_possible(lesion: Lesion) -> bool:
        radius = 0.5 * _BULGE * diameter
        is_low = lesion.protrusion <= 2.0 * _MAX_FILL * radius
        return is_low and lesion.footprint_radius <= _MAX_FOOTPRINT * radius

    for lesion in lesions:
        if lesion.extent == "focal" and not is_possible(lesion):
            sizes = (smaller.size for smaller in _smaller(lesion) if is_possible(smaller))
            size = next(sizes, 0.0)
            largest = f" Largest size that may fit: {size / MM:.1f} mm." if size else ""
            raise InputError(
                f"No location for {describe(lesion)}: it is {2e3 * lesion.footprint_radius:.1f} mm "
                f"wide and {abs(lesion.protrusion) / MM:.1f} mm high, but the lumen is "
                f"{diameter / MM:.1f} mm wide at most.{largest}"
            )


def candidates(
    organ: OrganSurface, location: Location, rng: np.random.Generator, num_vertices: int
) -> Iterator[int]:
    """Vertices allowed by a location: one if it is fully specified, else many random ones.

    Args:
        organ: Organ.
        location: Specified values.
        rng: Draws the other values.
        num_vertices: Number of leading vertices to choose from.
    """
    allowed = _allowed(organ, location)
    allowed = allowed[allowed < num_vertices]
    is_exact = location.arc_length is not None and location.theta is not None
    for _ in range(1 if is_exact else _NUM_TRIES):
        drawn = int(rng.choice(allowed))
        arc_length = organ.arc_length[drawn] if location.arc_length is None else location.arc_length
        theta = rng.uniform(-np.pi, np.pi) if location.theta is None else location.theta
        turn = (organ.theta[allowed] - theta + np.pi) % (2.0 * np.pi) - np.pi
        away = np.hypot(organ.arc_length[allowed] - arc_length, organ.radius[allowed] * turn)
        yield int(allowed[np.argmin(away)])


def _allowed(organ: OrganSurface, location: Location) -> Int[np.ndarray, " k"]:
    """Vertices of the location's segment, and near its arc length if specified.

    Raises:
        InputError: If the arc length is beyond the organ's end or outside the segment.
        UnknownNameError: If the organ has no such segment.
    """
    allowed = np.arange(len(organ.vertices))
    if location.segment is not None:
        names = [organ.label_names[k] for k in np.unique(organ.label)]
        if location.segment not in names:
            raise UnknownNameError("segment", location.segment, names)
        allowed = np.flatnonzero(organ.label == organ.label_names.index(location.segment))
    if location.arc_length is not None:
        low, high = organ.arc_length[allowed].min(), organ.arc_length[allowed].max()
        if not low <= location.arc_length <= high:
            where = organ.name if location.segment is None else location.segment
            raise InputError(
                f"Arc length {location.arc_length / CM:g} cm is not in {where}. Allowed: "
                f"{low / CM:.1f} to {high / CM:.1f} cm."
            )
    return allowed


def _misfit(
    organ: OrganSurface, wall: Wall, lesion: Lesion, others: list[PlacedLesion], vertex: int
) -> str:
    """Reason why a focal lesion does not fit at a vertex; empty if it does."""
    arc_length, reach = float(organ.arc_length[vertex]), lesion.footprint_radius
    line = organ.centerline
    if not reach < arc_length < line.length - reach:
        return (
            f"at {arc_length / CM:.1f} cm it reaches beyond the organ's end "
            f"(length {line.length / CM:.1f} cm)"
        )
    radius = float(np.interp(arc_length, line.arc_length, line.radius))
    if reach > _MAX_FOOTPRINT * radius:
        return (
            f"it is larger than the lumen, whose radius at {arc_length / CM:.1f} cm is "
            f"{radius / MM:.1f} mm"
        )
    crowded = _no_space(organ, wall, lesion, vertex)
    if crowded:
        return crowded
    for number, other in enumerate(others, start=1):
        apart = float(np.linalg.norm(other.center - organ.vertices[vertex]))
        if apart < reach + other.lesion.footprint_radius + _GAP:
            return f"it overlaps lesion {number}, {describe(other.lesion)}"
    return ""


def _no_space(organ: OrganSurface, wall: Wall, lesion: Lesion, vertex: int) -> str:
    """Reason for a lack of space over or behind the wall for a focal lesion; empty if it fits."""
    center, normal = organ.vertices[vertex], organ.normals[vertex]
    arc_length, reach = float(organ.arc_length[vertex]), lesion.footprint_radius
    side = "in the lumen" if lesion.protrusion >= 0.0 else "behind the wall"
    direction = normal if lesion.protrusion >= 0.0 else -normal
    free = _free_distance(wall, center, direction)
    if abs(lesion.protrusion) > _MAX_FILL * free:
        return (
            f"it stands {abs(lesion.protrusion) / MM:.1f} mm high, but {side} at "
            f"{arc_length / CM:.1f} cm only {free / MM:.1f} mm are free"
        )
    is_high = abs(lesion.protrusion) > 0.5 * lesion.head_radius
    side_clearance = (
        _free_beside(wall, center, abs(lesion.protrusion) * direction) if is_high else np.inf
    )
    if _BESIDE * lesion.head_radius > side_clearance:
        return (
            f"it is {2.0 * lesion.head_radius / MM:.1f} mm wide, but {side} at "
            f"{arc_length / CM:.1f} cm the adjacent wall is only {side_clearance / MM:.1f} mm away"
        )
    if lesion.protrusion < 0.0 and _unevenness(organ, center, normal, reach) > _UNEVEN * reach:
        return f"at {arc_length / CM:.1f} cm the wall is folded, where no pouch forms"
    return ""


def _unevenness(
    organ: OrganSurface,
    center: Float[np.ndarray, " 3"],
    normal: Float[np.ndarray, " 3"],
    reach: float,
) -> float:
    """Maximum distance [m] of the wall around a point from the tangent plane there."""
    offset = organ.vertices - center
    near = np.linalg.norm(offset, axis=1) < 1.2 * reach
    return float(np.abs(offset[near] @ normal).max())


def _free_distance(
    wall: Wall, center: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
) -> float:
    """Distance [m] to the opposite wall, along the normal and 25° around it."""
    side, other = _across(direction)
    tilts = [0.0 * side] + [0.47 * d for d in (side, -side, other, -other)]
    rays = np.array([direction + tilt for tilt in tilts])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    start = np.tile(center + _BEHIND * direction, (len(rays), 1))
    distance, _ = wall.cast(start, rays)
    return float(np.nan_to_num(distance, nan=np.inf).min()) + _BEHIND


def _free_beside(
    wall: Wall, center: Float[np.ndarray, " 3"], top: Float[np.ndarray, " 3"]
) -> float:
    """Distance [m] to the wall around the top of a protrusion of height `top` at a point."""
    side, other = _across(top)
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * other
    start = center + np.repeat([0.75, 1.0], len(ring))[:, None] * top
    distance, _ = wall.cast(start, np.tile(ring, (2, 1)))
    return float(np.nan_to_num(distance, nan=np.inf).min())


def _across(
    direction: Float[np.ndarray, " 3"],
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Two unit vectors orthogonal to a direction and to each other."""
    side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    other = np.cross(direction, side)
    return side / np.linalg.norm(side), other / np.linalg.norm(other)


def describe(lesion: Lesion) -> str:
    """Short description of a lesion."""
    words = [lesion.kind, lesion.grade]
    size = getattr(lesion, "size", None)
    if size is not None:
        words.append(f"of {size / MM:g} mm")
    return " ".join(word for word in words if word)
