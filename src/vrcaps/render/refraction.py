"""Where points appear that are seen through the level surface of a pool, or mirrored in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.lumen.lumen_contents import BEND_NAMES, LumenContents

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MIRRORED = BEND_NAMES.index("mirrored")

_STEPS = 40
"""Halvings of the interval that holds the place where light crosses the surface; Newton's method
needs some five, and what is left is for the grazing ones."""


@dataclass(frozen=True)
class Bends:
    """How the ways from an eye to points are bent.

    Attributes:
        apparent: Where the points appear: as far from the eye as the way is long, on the straight
            line on which the way leaves the eye; world frame [m].
        turn: Where the way is bent [m]; NaN where it is straight, None if all are.
    """

    apparent: Float[np.ndarray, "*n 3"]
    turn: Float[np.ndarray, "*n 3"] | None


def levels_met(
    lumen_contents: LumenContents,
    eye: Float[np.ndarray, " 3"],
    wall: Wall,
    faces: Int[np.ndarray, "m 3"],
    face: Int[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """Height of the surface that may lie between an eye and points [m]; NaN where none may.

    An eye in a pool has that pool's surface above it; an eye above has below it those of the pools
    that the points belong to.

    Args:
        lumen_contents: What is in the lumen.
        eye: In the world [m].
        wall: The wall, to know along which pool the eye is.
        faces: Of the wall.
        face: That each point lies on, −2 − k on sphere k of the lumen_contents.
    """
    levels, pools = np.full(face.shape, np.nan), lumen_contents.pools
    if pools is None:
        return levels
    heights = np.append(np.nan, pools.levels)
    nearest = np.asarray(wall.closest_point(eye[None])[1])[0]
    own = heights[pools.of_vertex[faces[nearest]].max()]
    if eye[2] < own:
        levels[...] = own
        return levels
    on_wall = face >= 0
    levels[on_wall] = heights[pools.of_vertex[faces[face[on_wall]]].max(axis=-1)]
    afloat = face < -1
    arc_length = lumen_contents.spheres.arc_length[-2 - face[afloat]]
    for (begin, end), height in zip(pools.stretch, pools.levels, strict=True):
        inside = (arc_length >= begin) & (arc_length <= end)
        levels[afloat] = np.where(inside, height, levels[afloat])
    levels[levels > eye[2]] = np.nan
    return levels


def bend_ways(
    eye: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "*n 3"],
    levels: Float[np.ndarray, "*n"],
    is_mirrored: Bool[np.ndarray, "*n"],
    ior: float,
) -> Bends:
    """Ways from an eye to points through level surfaces of liquid, by Snell's law.

    Args:
        eye: In the world [m].
        points: In the world [m].
        levels: Height of the surface between eye and point [m]; NaN for none.
        is_mirrored: Points to be seen mirrored in the surface, if they are in liquid as the eye is.
        ior: Refractive index of the liquid.
    """
    apparent, turn = points.astype(np.float64), np.full(points.shape, np.nan)
    with np.errstate(invalid="ignore"):
        is_across = (points[..., 2] < levels) != (eye[2] < levels)
        is_across &= np.isfinite(levels) & np.isfinite(points[..., 2])
        is_mirror = is_mirrored & ~is_across & (points[..., 2] < levels)
    apparent[is_mirror, 2] = 2.0 * levels[is_mirror] - points[is_mirror][:, 2]
    share = (levels[is_mirror] - eye[2]) / (apparent[is_mirror, 2] - eye[2])
    turn[is_mirror] = eye + share[:, None] * (apparent[is_mirror] - eye)
    turn[is_across] = _crossings(eye, points[is_across], levels[is_across], ior)
    first, second = turn[is_across] - eye, points[is_across] - turn[is_across]
    before, after = (np.linalg.norm(leg, axis=-1) for leg in (first, second))
    factor = (before + after) / np.maximum(before, 1e-12)
    apparent[is_across] = eye + factor[:, None] * first
    return Bends(apparent, turn)


def _crossings(
    eye: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "n 3"],
    levels: Float[np.ndarray, " n"],
    ior: float,
) -> Float[np.ndarray, "n 3"]:
    """Where light goes through a surface: the way that takes least time (Fermat).

    Its derivative along the line below eye and point rises steadily, so Newton's steps are kept
    between the ends that have been ruled out.
    """
    offset = points[:, :2] - eye[:2]
    reach = np.linalg.norm(offset, axis=-1)
    near, far = np.abs(eye[2] - levels), np.abs(points[:, 2] - levels)
    index_near, index_far = np.where(eye[2] < levels, (ior,), (1.0,)), 1.0 + 0.0 * levels
    index_far = np.where(eye[2] < levels, index_far, ior)
    low, high = np.zeros_like(reach), reach.copy()
    at = reach * near / np.maximum(near + far, 1e-12)
    for _ in range(_STEPS):
        before, after = np.hypot(at, near) + 1e-15, np.hypot(reach - at, far) + 1e-15
        slope = index_near * at / before - index_far * (reach - at) / after
        low, high = np.where(slope < 0.0, at, low), np.where(slope < 0.0, high, at)
        curve = index_near * near**2 / before**3 + index_far * far**2 / after**3
        newton = at - slope / np.maximum(curve, 1e-12)
        inside = (newton > low) & (newton < high)
        following = np.where(inside, newton, 0.5 * (low + high))
        if np.abs(following - at).max(initial=0.0) < 1e-12:
            break
        at = following
    along = offset * (at / np.maximum(reach, 1e-15))[:, None]
    return np.column_stack([eye[:2] + along, levels])
