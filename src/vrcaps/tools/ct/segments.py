"""Segments of a colon from the course of its centerline in the patient."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.colon.parameters import SEGMENTS, ColonParameters

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.organ.surface import Centerline

_HEPATIC_RANGE = (0.03, 0.45)  # fractions of the colon's length from the caecum
_SPLENIC_RANGE = (0.40, 0.80)


def runs_upwards(centerline: Centerline) -> bool:
    """Check whether a colon's centerline ends higher than it starts: the rectum lies lowest."""
    return bool(centerline.points[-1, 2] > centerline.points[0, 2])


def colon_borders(centerline: Centerline) -> Float[np.ndarray, " 7"]:
    """Arc lengths [m] at which the segments of a whole colon meet, from the caecum on.

    The hepatic flexure is the point farthest up and to the right in the first half of the course,
    the splenic one the point farthest up and to the left around its middle: loops of the transverse
    colon may rise as high, but between the two. Each flexure has its published fraction of the
    length. The stretches before, between and behind are divided in the published proportions
    (`ColonParameters`).

    Args:
        centerline: From the caecum to the rectum, patient frame.
    """
    mean = ColonParameters()
    length = {name: getattr(mean, name).length / mean.length for name in SEGMENTS}
    s, (left_of, _, height) = centerline.arc_length / centerline.length, centerline.points.T
    splenic = _farthest(s, height + left_of, _SPLENIC_RANGE)
    before = (_HEPATIC_RANGE[0], min(_HEPATIC_RANGE[1], splenic - 0.1))
    hepatic = _farthest(s, height - left_of, before)
    half_hepatic = min(length["hepatic_flexure"] / 2, 0.5 * hepatic)
    half_splenic = length["splenic_flexure"] / 2
    caecum, ascending = length["caecum"], length["ascending"]
    left = {name: length[name] for name in ("descending", "sigmoid", "rectum")}
    rest = (1.0 - splenic - half_splenic) / sum(left.values())
    descending = splenic + half_splenic + rest * left["descending"]
    borders = [
        (hepatic - half_hepatic) * caecum / (caecum + ascending),
        hepatic - half_hepatic,
        hepatic + half_hepatic,
        splenic - half_splenic,
        splenic + half_splenic,
        descending,
        descending + rest * left["sigmoid"],
    ]
    return centerline.length * np.array(borders)


def colon_labels(
    centerline: Centerline, arc_length: Float[np.ndarray, " n"]
) -> tuple[UInt8[np.ndarray, " n"], tuple[str, ...]]:
    """Segment of each vertex of a colon by its arc length, and the names of the segments."""
    label = 1 + np.searchsorted(colon_borders(centerline), arc_length)
    return label.astype(np.uint8), ("background", *SEGMENTS)


def _farthest(
    s: Float[np.ndarray, " n"], reach: Float[np.ndarray, " n"], between: tuple[float, float]
) -> float:
    """Position within a range of the course that is farthest in a direction."""
    inside = (s >= between[0]) & (s <= between[1])
    return float(s[inside][np.argmax(reach[inside])])
