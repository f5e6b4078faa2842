"""Pools: where liquid stands in the dips of a lumen."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.lumen.liquid import Liquid
from vrcaps.organ.surface import OrganSurface
from vrcaps.transforms import transform_points
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float, UInt16

_SPACING = 2.0 * MM
_AROUND = 24
_RINGS = 6
_SHALLOWEST = 0.5 * MM
"""Dips less deep than this hold nothing."""


@dataclass(frozen=True)
class Pools:
    """Bodies of liquid with level surfaces.

    Attributes:
        levels: Height of each surface in the world frame [m].
        of_vertex: Pool along whose stretch each vertex of the wall lies: 0 for none, 1 for the
            first. A vertex is wet where it is below its pool's level.
        stretch: Arc lengths at which each pool begins and ends [m].
        volume: Of each pool [m³].
    """

    levels: Float[np.ndarray, " p"]
    of_vertex: UInt16[np.ndarray, " n"]
    stretch: Float[np.ndarray, "p 2"]
    volume: Float[np.ndarray, " p"]


@dataclass(frozen=True)
class Sections:
    """The lumen as a pile of cross-sections, star-shaped about the centerline.

    Attributes:
        arc_length: Where the k sections are [m].
        points: Sample points of each section's area in the patient frame [m].
        volumes: Volume that each sample stands for [m³].
        rim: Outline of each section in the patient frame [m].
    """

    arc_length: Float[np.ndarray, " k"]
    points: Float[np.ndarray, "k q 3"]
    volumes: Float[np.ndarray, "k q"]
    rim: Float[np.ndarray, "k a 3"]


def cut_sections(organ: OrganSurface) -> Sections:
    """Cross-sections of an organ's lumen from the gut coordinates of its vertices."""
    from vrcaps.organ.centerline.curve import interpolate

    length = organ.centerline.length
    edges = np.linspace(0.0, length, max(4, round(length / _SPACING)) + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    radius = _radii(organ, edges)
    centers, frames, _ = interpolate(organ.centerline, middle)
    angle = 2.0 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND - np.pi
    way = (
        np.cos(angle)[:, None] * frames[:, None, :, 0]
        + np.sin(angle)[:, None] * (frames[:, None, :, 1])
    )
    # Rings of equal area, sampled at the middle of each.
    share = np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
    points = centers[:, None, None] + (radius[..., None] * share)[..., None] * way[:, :, None]
    area = radius**2 * np.pi / _AROUND / _RINGS
    volumes = np.repeat(area * np.diff(edges)[:, None], _RINGS, axis=1)
    rim = centers[:, None] + radius[..., None] * way
    return Sections(middle, points.reshape(len(middle), -1, 3), volumes, rim)


def _radii(organ: OrganSurface, edges: Float[np.ndarray, " e"]) -> Float[np.ndarray, "k a"]:
    """Mean distance of the wall from the centerline [m], by section and direction.

    Where no vertex lies in a field it is the mean of its section, or between sections.
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
    """Liquid at rest in an organ: in each dip of its floor up to what it holds.

    A dip lies between two crests of the lumen's floor and would hold the share `fill` of the
    lumen there, but no more than up to the lower crest: the rest runs off. Where two neighbors
    are both full to the crest between them they are one.

    Args:
        organ: The wall at rest.
        sections: Of the same organ.
        liquid: How much.
        T_world_patient: How the patient lies; gravity is world −z.

    Returns:
        None where the lumen holds no liquid.
    """
    height = transform_points(T_world_patient, sections.points)[..., 2]
    floor = _floor(organ, sections, T_world_patient)
    dips = _dips(floor)
    k = 0
    filled = [_level(floor, height, sections.volumes, dip, liquid.fill) for dip in dips]
    while k + 1 < len(dips):
        crest = floor[dips[k][1]]
        if min(filled[k], filled[k + 1]) >= crest - 1e-12 and liquid.fill > 0.0:
            dips[k : k + 2] = [(dips[k][0], dips[k + 1][1])]
            filled[k : k + 2] = [_level(floor, height, sections.volumes, dips[k], liquid.fill)]
            k = max(k - 1, 0)
        else:
            k += 1
    kept = [
        (dip, level)
        for dip, level in zip(dips, filled, strict=True)
        if level > floor[dip[0] : dip[1] + 1].min() + _SHALLOWEST
    ]
    if not kept:
        return None
    return _make(organ, sections, height, kept)


def _floor(
    organ: OrganSurface, sections: Sections, T_world_patient: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, " k"]:
    """Height of the lowest wall in each section [m]: of a vertex, or of the outline if none."""
    rim = transform_points(T_world_patient, sections.rim)[..., 2].min(axis=1)
    lowest = np.full(len(rim), np.inf)
    z = transform_points(T_world_patient, organ.vertices)[:, 2]
    np.minimum.at(lowest, _section_of(organ, sections), z)
    return np.where(np.isfinite(lowest), lowest, rim)


def _section_of(organ: OrganSurface, sections: Sections) -> np.ndarray:
    """Section in which each vertex lies."""
    step = sections.arc_length[1] - sections.arc_length[0]
    return (organ.arc_length / step).astype(int).clip(0, len(sections.arc_length) - 1)


def _dips(floor: Float[np.ndarray, " k"]) -> list[tuple[int, int]]:
    """Sections of the two crests around each dip; the ends of the organ are walls."""
    inner = np.arange(1, len(floor) - 1)
    is_crest = (floor[inner] >= floor[inner - 1]) & (floor[inner] > floor[inner + 1])
    ends = [0, *inner[is_crest].tolist(), len(floor) - 1]
    return list(pairwise(ends))


def _level(
    floor: Float[np.ndarray, " k"],
    height: Float[np.ndarray, "k q"],
    volumes: Float[np.ndarray, "k q"],
    dip: tuple[int, int],
    fill: float,
) -> float:
    """Height up to which a dip is filled [m]."""
    first, last = dip
    inside = slice(first, last + 1)
    heights, weights = height[inside].ravel(), volumes[inside].ravel()
    order = np.argsort(heights)
    below = np.append(0.0, np.cumsum(weights[order]))
    steps = np.append(floor[inside].min(), heights[order])
    wanted = float(np.interp(fill * below[-1], below, steps))
    left = np.inf if first == 0 else floor[first]
    right = np.inf if last == len(floor) - 1 else floor[last]
    return min(wanted, float(left), float(right))


def _make(
    organ: OrganSurface,
    sections: Sections,
    height: Float[np.ndarray, "k q"],
    kept: list[tuple[tuple[int, int], float]],
) -> Pools:
    section = _section_of(organ, sections)
    of_vertex = np.zeros(len(organ.arc_length), np.uint16)
    volume = []
    for number, ((first, last), level) in enumerate(kept, 1):
        of_vertex[(section >= first) & (section <= last)] = number
        inside = slice(first, last + 1)
        volume.append(sections.volumes[inside][height[inside] < level].sum())
    stretch = [(sections.arc_length[first], sections.arc_length[last]) for (first, last), _ in kept]
    return Pools(
        levels=np.array([level for _, level in kept]),
        of_vertex=of_vertex,
        stretch=np.array(stretch),
        volume=np.array(volume),
    )


def submerged(
    axis: tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]], radius: float, level: float
) -> tuple[float, Float[np.ndarray, " 3"]]:
    """Part of a capsule that is under a level surface.

    Slices across the axis, each a disc cut by a chord.

    Args:
        axis: Centers of the round ends in the world frame [m].
        radius: Of cylinder and ends [m].
        level: Height of the surface [m].

    Returns:
        Its volume [m³] and its center [m]; the middle of the axis where nothing is under.
    """
    slices = 200
    start, span = axis[0], axis[1] - axis[0]
    straight = float(np.linalg.norm(span))
    along = span / straight if straight > 0.0 else np.array([0.0, 0.0, 1.0])
    step = (straight + 2.0 * radius) / slices
    place = step * (np.arange(slices) + 0.5) - radius
    beyond = np.maximum(np.maximum(-place, place - straight), 0.0)
    disc = np.sqrt(np.maximum(radius**2 - beyond**2, 0.0))
    lean = float(np.hypot(along[0], along[1]))
    depth = level - (start[2] + place * along[2])
    # A disc spans `disc · lean` of height to each side of its middle, its thickness the rest.
    chord = np.clip(depth / np.maximum(disc * lean, 0.5 * step * abs(along[2]) + 1e-15), -1.0, 1.0)
    area = disc**2 * (np.pi - np.arccos(chord) + chord * np.sqrt(1.0 - chord**2))
    volume = float(area.sum() * step)
    middle = start + 0.5 * span
    if volume <= 0.0:
        return 0.0, middle
    up = (np.array([0.0, 0.0, 1.0]) - along[2] * along) / max(lean, 1e-12)
    sink = -2.0 / 3.0 * disc**3 * (1.0 - chord**2) ** 1.5
    center = start + along * float((area * place).sum() * step / volume)
    return volume, center + up * float(sink.sum() * step / volume) * (lean > 1e-9)
