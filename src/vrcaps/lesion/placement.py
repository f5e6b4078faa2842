"""Placement of lesions: as stated, or drawn until they fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.errors import InputError, UnknownNameError
from vrcaps.lesion.base import Lesion, Location, SizedLesion
from vrcaps.units import CM, MM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.organ.surface import OrganSurface

_NUM_TRIES = 60
_GAP = 2.0 * MM  # between the footprints of two lesions
_MAX_FILL = 0.8  # fraction of the free distance across the lumen that a lesion may take
_BESIDE = 1.05  # free distance beside what stands in the lumen, in its radii
_WIDEST = 1.3  # footprint's radius in radii of the lumen up to which the log map holds
_BEHIND = 0.3 * MM
_BULGE = 1.5  # of the diameter between folds, beyond which no lumen reaches from wall to wall
_SIZE_STEP = 0.5 * MM  # of the largest size that fits
_UNEVEN = 0.35  # height of the wall around a pouch, in radii of its footprint


@dataclass(frozen=True)
class PlacedLesion:
    """A lesion and the wall vertex at its middle.

    Attributes:
        lesion: Its specification.
        vertex: Number in the organ it was placed in.
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
    """Find the wall for a focal lesion: at its location, or anywhere that it fits.

    Args:
        organ: Without it.
        wall: The organ's, for clearance.
        lesion: What to place.
        others: Spots placed before, which it must not touch.
        rng: Draws what the location leaves open.
        num_vertices: How many of the first vertices are evenly spread over the wall.

    Raises:
        InputError: If it does not fit there, or nowhere in so many tries; states the largest of
            its kind that does.
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
    """Check that each focal lesion fits in a healthy organ, before any is made.

    Args:
        organ: Without lesions.
        wall: The organ's, for clearance.
        lesions: What to place.
        rngs: Source of each, left as it is.

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
    """Largest size [m] of a lesion of that kind that fits at one of some vertices; 0 if none."""

    def fits(smaller: Lesion) -> bool:
        return any(not _misfit(organ, wall, smaller, others, vertex) for vertex in vertices)

    return next((smaller.size for smaller in _smaller(lesion) if fits(smaller)), 0.0)


def _smaller(lesion: Lesion) -> Iterator[SizedLesion]:
    """The same lesion in all sizes below its own that its kind allows, the largest first."""
    if not isinstance(lesion, SizedLesion):
        return
    for step in range(math.floor(lesion.size / _SIZE_STEP), 0, -1):
        try:
            smaller = replace(lesion, size=step * _SIZE_STEP)
        except InputError:  # smaller than any of its kind
            return
        yield smaller


def require_possible(lesions: Sequence[Lesion], diameter: float) -> None:
    """Check that focal lesions are not larger than any place in a lumen that is not yet made.

    Args:
        lesions: What to place.
        diameter: Of the lumen at its widest [m], by the parameters it is made of.

    Raises:
        InputError: If one is; states the largest size that may fit.
    """

    def is_possible(lesion: Lesion) -> bool:
        radius = 0.5 * _BULGE * diameter
        is_low = lesion.protrusion <= 2.0 * _MAX_FILL * radius
        return is_low and lesion.footprint_radius <= _WIDEST * radius

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
    """Vertices that a location allows: one where it is fully stated, else many, drawn.

    Args:
        organ: The organ.
        location: What is stated.
        rng: Draws the rest.
        num_vertices: How many of the first vertices may be drawn.
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
    """Vertices of the location's segment, and near its arc length if that is stated.

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
    """Why a focal lesion does not fit at a vertex; empty if it does."""
    arc_length, reach = float(organ.arc_length[vertex]), lesion.footprint_radius
    line = organ.centerline
    if not reach < arc_length < line.length - reach:
        return (
            f"at {arc_length / CM:.1f} cm it reaches beyond the organ's end "
            f"(length {line.length / CM:.1f} cm)"
        )
    radius = float(np.interp(arc_length, line.arc_length, line.radius))
    if reach > _WIDEST * radius:
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
    """Why there is no space over the wall for a focal lesion, or behind it; empty if there is."""
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
    beside = _free_beside(wall, center, abs(lesion.protrusion) * direction) if is_high else np.inf
    if _BESIDE * lesion.head_radius > beside:
        return (
            f"it is {2.0 * lesion.head_radius / MM:.1f} mm wide, but {side} at "
            f"{arc_length / CM:.1f} cm the wall beside is only {beside / MM:.1f} mm away"
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
    """Largest distance [m] of the wall around a point from the tangent plane there."""
    offset = organ.vertices - center
    near = np.linalg.norm(offset, axis=1) < 1.2 * reach
    return float(np.abs(offset[near] @ normal).max())


def _free_distance(
    wall: Wall, center: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
) -> float:
    """Distance [m] from the wall to the next wall, along the normal and 25° around it."""
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
    """Distance [m] to the wall around the top of what stands at a point, `top` high."""
    side, other = _across(top)
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * other
    start = center + np.repeat([0.75, 1.0], len(ring))[:, None] * top
    distance, _ = wall.cast(start, np.tile(ring, (2, 1)))
    return float(np.nan_to_num(distance, nan=np.inf).min())


def _across(
    direction: Float[np.ndarray, " 3"],
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Two unit vectors square to a direction and to each other."""
    side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    other = np.cross(direction, side)
    return side / np.linalg.norm(side), other / np.linalg.norm(other)


def describe(lesion: Lesion) -> str:
    """A lesion in a few words."""
    words = [lesion.kind, lesion.grade]
    size = getattr(lesion, "size", None)
    if size is not None:
        words.append(f"of {size / MM:g} mm")
    return " ".join(word for word in words if word)
