"""Pools: liquid that stands in the dips of a lumen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import transform_points
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Liquid
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt16

_SPACING = 2.0 * MM
_AROUND = 24
_RINGS = 6
_SHALLOWEST = 0.5 * MM
"""Minimum depth of a dip that holds liquid [m]."""


@dataclass(frozen=True)
class Pools:
    """Bodies of liquid with level surfaces.

    Attributes:
        levels: Height of each surface in the world frame [m].
        of_vertex: Pool of the interval that contains each vertex of the wall: 0 for none, 1 for the
            first. A vertex is wet if it is below the level of its pool.
        stretch: Arc-length interval of each pool [m].
        volume: Volume of each pool [m³].
        section_volume: Liquid in each section of the lumen [m³], even if too shallow for a pool.
    """

    levels: Float[np.ndarray, " p"]
    of_vertex: UInt16[np.ndarray, " n"]
    stretch: Float[np.ndarray, "p 2"]
    volume: Float[np.ndarray, " p"]
    section_volume: Float[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Sections:
    """Lumen as a stack of cross-sections, star-shaped around the centerline.

    Attributes:
        arc_length: Arc lengths of the k sections [m].
        centers: Centerline at each section in the patient frame [m].
        points: Sample points of each section's area in the patient frame [m].
        volumes: Volume represented by each sample [m³].
        rim: Outline of each section in the patient frame [m].
    """

    arc_length: Float[np.ndarray, " k"]
    centers: Float[np.ndarray, "k 3"]
    points: Float[np.ndarray, "k q 3"]
    volumes: Float[np.ndarray, "k q"]
    rim: Float[np.ndarray, "k a 3"]

    def of(self, arc_length: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Index of the section that contains each arc length [m]."""
        step = self.arc_length[1] - self.arc_length[0]
        return (arc_length / step).astype(int).clip(0, len(self.arc_length) - 1)


def cut_sections(organ: OrganSurface) -> Sections:
    """Compute cross-sections of an organ's lumen from the gut coordinates of its vertices."""
    from vrcaps.organ.surface import interpolate

    length = organ.centerline.length
    edges = np.linspace(0.0, length, max(4, round(length / _SPACING)) + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    radius = _radii(organ, edges)
    centers, frames, _ = interpolate(organ.centerline, middle)
    angle = 2.0 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND - np.pi
    direction = (
        np.cos(angle)[:, None] * frames[:, None, :, 0]
        + np.sin(angle)[:, None] * (frames[:, None, :, 1])
    )
    # Rings of equal area, each sampled at its middle.
    fraction = np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
    points = (
        centers[:, None, None] + (radius[..., None] * fraction)[..., None] * direction[:, :, None]
    )
    area = radius**2 * np.pi / _AROUND / _RINGS
    volumes = np.repeat(area * np.diff(edges)[:, None], _RINGS, axis=1)
    rim = centers[:, None] + radius[..., None] * direction
    return Sections(middle, centers, points.reshape(len(middle), -1, 3), volumes, rim)


def _radii(organ: OrganSurface, edges: Float[np.ndarray, " e"]) -> Float[np.ndarray, "k a"]:
    """Mean distance of the wall from the centerline [m], by section and direction.

    Bins without vertices take the mean of their section, or are interpolated between sections.
    """
    around = np.linspace(-np.pi, np.pi, _AROUND + 1)
    fields = [edges, around]
    count, _, _ = np.histogram2d(organ.arc_length, organ.theta, fields)
    total, _, _ = np.histogram2d(organ.arc_length, organ.theta, fields, weights=organ.radius)
    rows = count.sum(axis=1)
    known = np.flatnonzero(rows)
    mean = np.interp(np.arange(len(rows)), known, total.sum(axis=1)[known] / rows[known])
    return np.where(count > 0, total / np.maximum(count, 1), mean[:, None])


def find_pools(
    organ: OrganSurface,
    sections: Sections,
    liquid: Liquid,
    T_world_patient: Float[np.ndarray, "4 4"],
) -> Pools | None:
    """Place liquid at rest in an organ, in each dip of its floor up to its capacity.

    A dip lies between two crests of the lumen's floor and takes the fraction `fill` of the lumen
    there, but at most up to the lower crest; the rest runs off. Two neighbors that are both full
    to the crest between them are merged.

    Args:
        organ: The wall at rest.
        sections: Sections of the same organ.
        liquid: Amount of liquid.
        T_world_patient: Posture of the patient; gravity is world −z.

    Returns:
        The pools, or None if the lumen holds no liquid.
    """
    if liquid.fill == 0.0:
        return None
    lumen = _Lumen.at_rest(organ, sections, T_world_patient)
    filled = [
        lumen.basin(first, last).holding(liquid.fill, most=min(lumen.crests(first, last)))
        for first, last in _dips(lumen.floor)
    ]
    k = 0
    while k + 1 < len(filled):
        left, right = filled[k], filled[k + 1]
        if min(left.level, right.level) >= lumen.floor[left.last] - 1e-12:
            first, last = left.first, right.last
            most = min(lumen.crests(first, last))
            filled[k : k + 2] = [lumen.basin(first, last).holding(liquid.fill, most=most)]
            k = max(k - 1, 0)
        else:
            k += 1
    pools = lumen.pools(organ, sections, filled)
    return pools if len(pools.levels) else None


def level_pools(
    organ: OrganSurface,
    sections: Sections,
    section_volume: Float[np.ndarray, " k"],
    T_world_patient: Float[np.ndarray, "4 4"],
    scale: Float[np.ndarray, " k"],
) -> Pools:
    """Level the same liquid again after the wall has moved or the patient has turned.

    Volume is conserved: liquid that a dip cannot hold overflows its lower crest into the next one.

    Args:
        organ: The wall at rest.
        sections: Sections of the same organ.
        section_volume: Liquid in each section before [m³].
        T_world_patient: Posture of the patient now; gravity is world −z.
        scale: Radius of the lumen in each section, relative to that at rest.
    """
    lumen = _Lumen.at_rest(organ, sections, T_world_patient).scaled(scale)
    filled = []
    for first, last in _dips(lumen.floor):
        # A crest belongs to the dip that starts there.
        end = last + (last == len(section_volume) - 1)
        filled.append(lumen.basin(first, last).with_volume(float(section_volume[first:end].sum())))
    k = 0
    while k < len(filled):
        crests = lumen.crests(filled[k].first, filled[k].last)
        if filled[k].level <= min(crests) + 1e-12:
            k += 1
            continue
        side = int(np.argmin(crests))
        k = _run_over(lumen, filled, k, k - 1 + 2 * side, crests[side])
    return lumen.pools(organ, sections, filled)


def _run_over(lumen: _Lumen, filled: list[_Basin], k: int, other: int, crest: float) -> int:
    """Let dip `k` overflow a crest into a neighbor, or merge both; returns the next dip."""
    one, two = filled[k], filled[other]
    if two.level >= crest - 1e-12:
        first, last = min(one.first, two.first), max(one.last, two.last)
        lower = min(k, other)
        filled[lower : lower + 2] = [lumen.basin(first, last).with_volume(one.volume + two.volume)]
        return max(lower - 1, 0)
    full = one.filled_to(crest)
    filled[k], filled[other] = full, two.with_volume(two.volume + one.volume - full.volume)
    return min(k, other)


@dataclass(frozen=True)
class _Basin:
    """Dip of the lumen's floor with liquid in it.

    Attributes:
        first: Section of one crest.
        last: Section of the other crest.
        steps: Ascending heights [m].
        below: Volume of the dip below each height [m³].
        level: Height of the liquid [m].
        volume: Volume of the liquid [m³].
    """

    first: int
    last: int
    steps: Float[np.ndarray, " m"]
    below: Float[np.ndarray, " m"]
    level: float
    volume: float = 0.0

    def with_volume(self, volume: float) -> _Basin:
        """The same dip with a volume of liquid [m³], at most up to its top."""
        level = float(np.interp(volume, self.below, self.steps))
        return replace(self, level=level, volume=volume)

    def filled_to(self, level: float) -> _Basin:
        """The same dip filled to a level [m]."""
        volume = float(np.interp(level, self.steps, self.below))
        return replace(self, level=level, volume=volume)

    def holding(self, share: float, *, most: float) -> _Basin:
        """The same dip with a fraction of its volume, but at most to a level [m]."""
        wanted = float(np.interp(share * self.below[-1], self.below, self.steps))
        return self.filled_to(min(wanted, most))


@dataclass(frozen=True)
class _Lumen:
    """Sections of a lumen in the world frame.

    Attributes:
        floor: Height of the lowest wall in each section [m].
        axis: Height of the centerline in each section [m].
        height: Height of each sample of a section's area [m].
        volumes: Volume represented by each sample [m³].
    """

    floor: Float[np.ndarray, " k"]
    axis: Float[np.ndarray, " k"]
    height: Float[np.ndarray, "k q"]
    volumes: Float[np.ndarray, "k q"]

    @classmethod
    def at_rest(
        cls, organ: OrganSurface, sections: Sections, T_world_patient: Float[np.ndarray, "4 4"]
    ) -> _Lumen:
        """Lumen with the wall at rest."""
        height = transform_points(T_world_patient, sections.points)[..., 2]
        axis = transform_points(T_world_patient, sections.centers)[:, 2]
        floor = _floor(organ, sections, T_world_patient)
        return cls(floor, axis, height, sections.volumes)

    def scaled(self, scale: Float[np.ndarray, " k"]) -> _Lumen:
        """Lumen with the wall's distance from the centerline scaled by section."""
        axis, wide = self.axis[:, None], scale[:, None]
        floor = self.axis + scale * (self.floor - self.axis)
        return _Lumen(floor, self.axis, axis + wide * (self.height - axis), wide**2 * self.volumes)

    def basin(self, first: int, last: int) -> _Basin:
        """Empty dip between the crests in two sections."""
        inside = slice(first, last + 1)
        heights, weights = self.height[inside].ravel(), self.volumes[inside].ravel()
        order = np.argsort(heights, kind="stable")
        below = np.append(0.0, np.cumsum(weights[order]))
        steps = np.append(self.floor[inside].min(), heights[order])
        return _Basin(first, last, np.maximum.accumulate(steps), below, float(steps[0]))

    def crests(self, first: int, last: int) -> tuple[float, float]:
        """Heights of a dip's crests [m]; the ends of the organ are walls."""
        left = np.inf if first == 0 else float(self.floor[first])
        return left, np.inf if last == len(self.floor) - 1 else float(self.floor[last])

    def pools(self, organ: OrganSurface, sections: Sections, filled: list[_Basin]) -> Pools:
        """Dips that are deep enough as pools, and all liquid by section."""
        section_volume, pool = np.zeros(len(self.floor)), np.zeros(len(self.floor), np.uint16)
        kept = []
        for dip in filled:
            inside = slice(dip.first, dip.last + 1)
            share = (self.volumes[inside] * (self.height[inside] < dip.level)).sum(axis=1)
            if not share.any():
                share[np.argmin(self.floor[inside])] = 1.0
            section_volume[inside] += dip.volume * share / share.sum()
            if dip.level > self.floor[inside].min() + _SHALLOWEST:
                kept.append(dip)
                pool[inside] = len(kept)
        s = sections.arc_length
        return Pools(
            levels=np.array([dip.level for dip in kept]),
            of_vertex=pool[sections.of(organ.arc_length)],
            stretch=np.array([(s[dip.first], s[dip.last]) for dip in kept]).reshape(-1, 2),
            volume=np.array([dip.volume for dip in kept]),
            section_volume=section_volume,
        )


def _floor(
    organ: OrganSurface, sections: Sections, T_world_patient: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, " k"]:
    """Height of the lowest wall in each section [m]: of its vertices, else of its outline."""
    rim = transform_points(T_world_patient, sections.rim)[..., 2].min(axis=1)
    lowest = np.full(len(rim), np.inf)
    z = transform_points(T_world_patient, organ.vertices)[:, 2]
    np.minimum.at(lowest, sections.of(organ.arc_length), z)
    return np.where(np.isfinite(lowest), lowest, rim)


def _dips(floor: Float[np.ndarray, " k"]) -> list[tuple[int, int]]:
    """Sections of the two crests around each dip; the ends of the organ are walls."""
    inner = np.arange(1, len(floor) - 1)
    is_crest = (floor[inner] >= floor[inner - 1]) & (floor[inner] > floor[inner + 1])
    ends = [0, *inner[is_crest].tolist(), len(floor) - 1]
    return list(pairwise(ends))


def submerged(
    axis: tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]], radius: float, level: float
) -> tuple[float, Float[np.ndarray, " 3"]]:
    """Submerged part of a capsule under a level surface.

    Sums slices across the axis, each a disc cut by a chord.

    Args:
        axis: Centers of the round ends in the world frame [m].
        radius: Radius of cylinder and ends [m].
        level: Height of the surface [m].

    Returns:
        Its volume [m³] and center [m]; the middle of the axis if nothing is submerged.
    """
    slices = 200
    start, span = axis[0], axis[1] - axis[0]
    straight = float(np.linalg.norm(span))
    along = span / straight if straight > 0.0 else np.array([0.0, 0.0, 1.0])
    step = (straight + 2.0 * radius) / slices
    position = step * (np.arange(slices) + 0.5) - radius
    beyond = np.maximum(np.maximum(-position, position - straight), 0.0)
    disc = np.sqrt(np.maximum(radius**2 - beyond**2, 0.0))
    lean = float(np.hypot(along[0], along[1]))
    depth = level - (start[2] + position * along[2])
    # A disc spans `disc · lean` of height to each side of its center, its thickness the rest.
    chord = np.clip(depth / np.maximum(disc * lean, 0.5 * step * abs(along[2]) + 1e-15), -1.0, 1.0)
    area = disc**2 * (np.pi - np.arccos(chord) + chord * np.sqrt(1.0 - chord**2))
    volume = float(area.sum() * step)
    middle = start + 0.5 * span
    if volume <= 0.0:
        return 0.0, middle
    up = (np.array([0.0, 0.0, 1.0]) - along[2] * along) / max(lean, 1e-12)
    sink = -2.0 / 3.0 * disc**3 * (1.0 - chord**2) ** 1.5
    center = start + along * float((area * position).sum() * step / volume)
    return volume, center + up * float(sink.sum() * step / volume) * (lean > 1e-9)
