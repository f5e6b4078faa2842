"""Rotation-minimizing frames along a course: map from tube coordinates (s, θ, r) to space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Course:
    """Course of a tubular organ.

    Attributes:
        points: Samples from the oral to the anal end [m], patient frame, evenly spaced.
        arc_length: Arc length of each sample [m].
    """

    points: Float[np.ndarray, "n 3"]
    arc_length: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Tube:
    """Smooth curve with transverse axes.

    Attributes:
        curve: Function from arc length [m] to position [m], patient frame.
        arc_length: Samples of the frames [m].
        frames: Rotation at each sample; columns are two transverse axes and the tangent.
        bend: Curvature vector at each sample, averaged over about 2 cm [1/m].
    """

    curve: scipy.interpolate.CubicSpline
    arc_length: Float[np.ndarray, " n"]
    frames: Float[np.ndarray, "n 3 3"]
    bend: Float[np.ndarray, "n 3"]

    def points(
        self,
        arc_length: Float[np.ndarray, " n"],
        theta: Float[np.ndarray, " n"],
        radius: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n 3"]:
        """Convert tube coordinates to positions [m].

        Args:
            arc_length: Arc length along the course [m].
            theta: Angle around it [rad].
            radius: Distance from it [m].
        """
        return self.curve(arc_length) + radius[:, None] * self._outward(arc_length, theta)

    def curvature_towards(
        self, arc_length: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Curvature [1/m] averaged over about 2 cm, positive where it bends towards the angle θ."""
        bend = [np.interp(arc_length, self.arc_length, self.bend[:, k]) for k in range(3)]
        return np.einsum("ji,ij->i", np.array(bend), self._outward(arc_length, theta))

    def angle_of(self, arc_length: float, direction: Float[np.ndarray, " 3"]) -> float:
        """Angle θ [rad] whose transverse direction is nearest to a direction."""
        frame = self.frames[np.argmin(np.abs(self.arc_length - arc_length))]
        return float(np.arctan2(direction @ frame[:, 1], direction @ frame[:, 0]))

    def _outward(self, arc_length: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Unit transverse direction at the angle θ."""
        tangent = self.curve(arc_length, 1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        first = np.stack(
            [np.interp(arc_length, self.arc_length, self.frames[:, k, 0]) for k in range(3)], axis=1
        )
        first -= np.einsum("ij,ij->i", first, tangent)[:, None] * tangent
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(tangent, first)
        return np.cos(theta)[:, None] * first + np.sin(theta)[:, None] * second


def make_tube(course: Course) -> Tube:
    """Frames along a course by the double reflection method (Wang et al. 2008)."""
    curve = scipy.interpolate.CubicSpline(course.arc_length, course.points)
    points, tangents = course.points, curve(course.arc_length, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    axes = np.empty_like(points)
    # Angle 0 starts posteriorly, where the ascending colon is fixed.
    axes[0] = np.cross(tangents[0], np.cross([0.0, 1.0, 0.0], tangents[0]))
    axes[0] /= np.linalg.norm(axes[0])
    for i in range(len(points) - 1):
        step = points[i + 1] - points[i]
        axis = axes[i] - 2.0 * (step @ axes[i]) / (step @ step) * step
        tangent = tangents[i] - 2.0 * (step @ tangents[i]) / (step @ step) * step
        mirror = tangents[i + 1] - tangent
        square = mirror @ mirror
        axes[i + 1] = axis - 2.0 * (mirror @ axis) / square * mirror if square > 0.0 else axis
    frames = np.stack([axes, np.cross(tangents, axes), tangents], axis=-1)
    spacing = course.arc_length[1]
    bend = scipy.ndimage.gaussian_filter1d(
        curve(course.arc_length, 2), 7 * MM / spacing, axis=0, mode="nearest"
    )
    return Tube(curve, course.arc_length, frames, bend)
