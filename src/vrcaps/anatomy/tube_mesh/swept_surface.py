"""Swept surface: a tube's wall as a function r(s, θ), its triangle grid, waves and folds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.anatomy.tube_mesh.tube import Tube


FREE, SEAM, POLE = 0, 1, 2


@dataclass(frozen=True)
class Crests:
    """Lines around the lumen, all sampled at the same angles.

    Attributes:
        arc_length: Arc length of each line at each angle [m].
        weight: Strength with which a row of vertices follows it there, 0 to 1.
    """

    arc_length: Float[np.ndarray, "n k"]
    weight: Float[np.ndarray, "n k"]


@dataclass(frozen=True)
class SweptSurface:
    """Star-shaped wall r(s, θ) around a course, closed at both ends.

    Attributes:
        tube: Course with its frames.
        length: Length of the course [m].
        envelope: Radius [m] of the plain tube at arc lengths [m]; 0 at both ends.
        radius: Distance of the wall from the course [m] at arc lengths [m] and angles [rad].
        edge: Target edge length at arc lengths [m].
        crests: Sharp folds at angles [rad], along which rows of vertices are aligned.
    """

    tube: Tube
    length: float
    envelope: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]
    radius: Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]
    edge: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]
    crests: Callable[[Float[np.ndarray, " k"]], Crests] | None = None

    def points(
        self, arc_length: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Positions of the wall [m] at arc lengths and angles."""
        return self.tube.points(arc_length, theta, self.radius(arc_length, theta))


@dataclass(frozen=True)
class Meridian:
    """Length along the outline of the plain tube: like arc length, but uniform over closed ends.

    Attributes:
        arc_length: Samples [m].
        along: Meridian length of each [m].
    """

    arc_length: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]

    def to_arc_length(self, along: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Arc length [m] at a meridian length [m]."""
        return np.interp(along, self.along, self.arc_length)

    def to_along(self, arc_length: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Meridian length [m] at an arc length [m]."""
        return np.interp(arc_length, self.arc_length, self.along)


def make_meridian(surface: SweptSurface) -> Meridian:
    """Outline of a plain tube, sampled densely at its closed ends."""
    middle = np.linspace(0.0, surface.length, max(8001, round(surface.length / 2.5e-4)))
    near = min(0.05, 0.3 * surface.length) * np.linspace(0.0, 1.0, 400) ** 2
    s = np.unique(np.concatenate([middle, near, surface.length - near]))
    steps = np.hypot(np.diff(s), np.diff(surface.envelope(s)))
    return Meridian(s, np.concatenate([[0.0], np.cumsum(steps)]))


@dataclass(frozen=True)
class Grid:
    """Vertices of a closed tube by surface coordinates, and their faces.

    Attributes:
        along: Meridian length from the oral pole [m].
        theta: Angle, −π at the seam [rad].
        pinned: `FREE`, `SEAM` or `POLE`.
        faces: Vertex indices, counter-clockwise as seen from inside.
    """

    along: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    pinned: Int[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]


def turn_fractions(grid: Grid) -> Float[np.ndarray, "m 3"]:
    """Fraction of the circumference from the seam at each corner, continuous within faces."""
    pinned = grid.pinned[grid.faces]
    theta = grid.theta[grid.faces]
    side = np.sum(np.where(pinned == FREE, theta, 0.0), axis=1, keepdims=True)
    theta = np.where((pinned == SEAM) & (side > 0.0), np.pi, theta)
    fraction = 0.5 - theta / (2.0 * np.pi)
    is_pole = pinned == POLE
    others = np.sum(np.where(is_pole, 0.0, fraction), axis=1, keepdims=True) / np.sum(
        ~is_pole, axis=1, keepdims=True
    )
    return np.where(is_pole, others, fraction)


def wrap(angle: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Wrap angles to −π to π [rad]."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def within_bend(
    radius: Float[np.ndarray, " n"], curvature: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Smooth minimum of a radius [m] and 0.72 of the bend radius, so that sections never cross."""
    ratio = radius * np.clip(curvature, 0.0, None) / 0.72
    return radius * (1.0 + ratio**8) ** -0.125


def dome(distance: Float[np.ndarray, " n"], depth: float) -> Float[np.ndarray, " n"]:
    """Radius at a distance [m] from an elliptically closed end, as a fraction of the open one."""
    return np.sqrt(1.0 - np.clip(1.0 - distance / depth, 0.0, 1.0) ** 2)


@dataclass(frozen=True)
class Folds:
    """Folds sorted by arc length.

    Attributes:
        arc_length: Center of each crest [m].
        angle: Center of each crest around the lumen [rad], from the reference angle of the organ.
        height: Height above the wall [m].
        extent: Half angle spanned by each crest [rad]; beyond π it is a full ring.
        thickness: Full width at half height [m].
        tilt: Slope of the crest relative to the circumference.
        bow: Curvature of the crest along the gut, per radius.
    """

    arc_length: Float[np.ndarray, " n"]
    angle: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    extent: Float[np.ndarray, " n"]
    thickness: Float[np.ndarray, " n"]
    tilt: Float[np.ndarray, " n"]
    bow: Float[np.ndarray, " n"]

    def crest(
        self,
        index: Int[np.ndarray, "*shape"],
        offset: Float[np.ndarray, "*shape"],
        radius: Float[np.ndarray, "*shape"],
    ) -> Float[np.ndarray, "*shape"]:
        """Arc length [m] of crests at angles from their centers.

        Args:
            index: Index of each fold.
            offset: Angle from its center [rad].
            radius: Radius of the plain lumen there [m].
        """
        slope = self.tilt[index] * np.sin(offset) + self.bow[index] * (1.0 - np.cos(offset))
        return self.arc_length[index] + radius * slope
