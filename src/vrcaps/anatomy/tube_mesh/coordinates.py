"""Gut coordinates of a generated wall with known sections along the course."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.organ.centerline import interpolate
from vrcaps.organ.surface import Centerline

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.tube_mesh.tube import Tube


def arc_length_of_sections(
    sections: Float[np.ndarray, " n"], tube: Tube, centerline: Centerline
) -> Float[np.ndarray, " n"]:
    """Arc length [m] at which a centerline passes the sections of a tube.

    The centerline may start next to the tube's course and join it; sections before its start map
    to its start. The result is continuous and monotonic in the section.

    Args:
        sections: Arc lengths on the tube's course [m].
        tube: The course.
        centerline: In the same frame; follows the course in the same direction.
    """
    _, nearest = scipy.spatial.KDTree(tube.curve(tube.arc_length)).query(centerline.points)
    passed = np.maximum.accumulate(tube.arc_length[nearest])
    passed, first = np.unique(passed, return_index=True)
    return np.interp(sections, passed, centerline.arc_length[first])


def angle_and_radius(
    points: Float[np.ndarray, "n 3"],
    arc_length: Float[np.ndarray, " n"],
    centerline: Centerline,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Angle [rad] around a centerline and distance [m] from it, of points at arc lengths [m].

    Args:
        points: Positions [m].
        arc_length: Arc length of each point on the centerline [m].
        centerline: In the same frame.
    """
    at, frames, _ = interpolate(centerline, arc_length)
    offset = points - at
    x, y = (np.einsum("ij,ij->i", offset, frames[:, :, k]) for k in range(2))
    theta = np.arctan2(y, x)
    return np.where(theta <= -np.pi, np.pi, theta), np.linalg.norm(offset, axis=1)


def tube_centerline(tube: Tube, vertices: Float[np.ndarray, "n 3"]) -> Centerline:
    """Course of a tube as a centerline, with the clearance to the nearest vertex of its wall."""
    points = tube.curve(tube.arc_length)
    clearance, _ = scipy.spatial.KDTree(vertices).query(points)
    return Centerline(points, tube.arc_length, clearance, tube.frames)
