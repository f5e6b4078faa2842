"""Forms and films shared by kinds of lesions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import mix
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.lesion.base import AppearanceSample, LesionSite, WallSamples
from vrcaps.mesh.noise import angular_harmonics, low_pass

if TYPE_CHECKING:
    from jaxtyping import Float


FRESH = np.array([0.084, 0.0078, 0.0080])
"""Linear reflectance of a thick layer of fresh blood."""

OLD = np.array([0.025, 0.0050, 0.0050])
"""Linear reflectance of a thick layer of clotted blood."""

FIBRIN = np.array([0.39, 0.30, 0.21])
"""Linear reflectance of fibrin and slough on an ulcer."""

BLOOD_EXTINCTION = np.array([0.8, 9.0, 8.5]) / MM
"""Two-way optical density per length of a film of whole blood: red, green, blue. Hemoglobin
at 150 g/l absorbs green and blue about ten times as much as red (Prahl 1999, tabulated
extinction); the scale is fitted visually to thin films in endoscopic images."""


def under_blood(
    color: Float[np.ndarray, "n 3"],
    thickness: Float[np.ndarray, " n"],
    age: Float[np.ndarray, " n"] | float = 0.0,
) -> Float[np.ndarray, "n 3"]:
    """Reflectance of a wall under a film of blood, from its transmittance.

    Args:
        color: Linear reflectance without the film.
        thickness: Thickness of the film [m].
        age: Age of the blood, 0 (fresh) to 1 (clotted).
    """
    body = FRESH + (OLD - FRESH) * np.broadcast_to(age, len(color))[:, None]
    return body + (color - body) * np.exp(-thickness[:, None] * BLOOD_EXTINCTION)


_BORDER_FRACTION = 0.0125
"""Edge length of the triangles on the footprint's border, in footprint radii: the mask consists of
whole triangles and then matches the footprint to 0.5 %."""
_SIZING_ROUNDS = 3
"""Iterations to fit a profile to a size; each leaves a tenth of the error."""


class FocalForm:
    """Flat lesion with a wavy outline; subclasses define its height and appearance.

    Attributes:
        site: Site of the lesion.
        radius: Mean radius of its footprint [m].
        edge_length: Edge length of the triangles that represent its shape [m].
        border_length: Edge length of the triangles on its border [m].
    """

    def __init__(
        self, site: LesionSite, radius: float, rng: np.random.Generator, *, waviness: float = 0.1
    ) -> None:
        self.site, self.radius = site, radius
        self.edge_length = float(np.clip(radius / 8.0, 0.1 * MM, 0.7 * MM))
        self.border_length = _BORDER_FRACTION * radius
        self._outline, self._waviness = angular_harmonics(5, rng), waviness

    def polar(
        self, wall: WallSamples
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        """Distance from the center [m], unit direction in the log map, outline in mean radii."""
        rho = np.linalg.norm(wall.xy, axis=1)
        angle = np.arctan2(wall.xy[:, 1], wall.xy[:, 0])
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return rho, direction, 1.0 + self._waviness * self._outline(angle)

    def normalized_radius(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance from the center, 1 on the outline."""
        rho, _, stretch = self.polar(wall)
        return rho / (stretch * self.radius)

    def signed_distance(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance within the outline [m]."""
        rho, _, stretch = self.polar(wall)
        return stretch * self.radius - rho

    def height(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Height over the wall at rest [m], zero on the outline."""
        return np.zeros(len(wall.xy))

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions [m]: the wall raised along its normals."""
        lift = np.where(self.normalized_radius(wall) < 1.0, self.height(wall), 0.0)
        return wall.rest + lift[:, None] * wall.normal

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Log map itself [m]."""
        return wall.xy

    def blended(
        self,
        wall: WallSamples,
        clean: AppearanceSample,
        look: tuple[np.ndarray, np.ndarray, np.ndarray],
        *,
        softness: float,
    ) -> AppearanceSample:
        """Blend color, roughness and height inside the outline with the surroundings.

        Args:
            wall: Wall samples.
            clean: Appearance outside.
            look: Color (n, 3), roughness and height (n,) inside.
            softness: Width of the transition, in radii.
        """
        inside = smoothstep(self.signed_distance(wall) / (softness * self.radius))
        color, roughness, height = look
        return replace(
            clean,
            color=np.clip(mix(clean.color, color, inside), 0.0, 1.0),
            roughness=clean.roughness + (roughness - clean.roughness) * inside,
            height=clean.height + (height - clean.height) * inside,
        )


class ProfileForm(FocalForm):
    """Surface of revolution of a profile around the wall normal: polyp, mass or pouch.

    Args:
        site: Site of the lesion.
        control: Control points of the profile's cubic B-spline, from the rim of the footprint to
            the top: distance from the axis and height [m].
        rng: Draws the irregularities.
        waviness: Waviness of the outline.
        upright: Whether it stands on a plane instead of following the wall's curvature.
        lobes: RMS height and spacing of its lobes [m].
        lean: Sideways offset at the middle of the head, in squared heights over the total
            height, patient frame.
        size: Maximum diameter across the axis [m]; for a head on a stalk, that of the head. The
            profile is scaled in width so that the irregular shape has this size. None: unchanged.
    """

    def __init__(
        self,
        site: LesionSite,
        control: Float[np.ndarray, "k 2"],
        rng: np.random.Generator,
        *,
        waviness: float,
        upright: bool,
        lobes: tuple[float, float],
        lean: Float[np.ndarray, " 3"] | None = None,
        size: float | None = None,
    ) -> None:
        super().__init__(site, float(control[0, 0]), rng, waviness=waviness)
        self._upright = upright
        self._lobe_height = lobes[0]
        self._lobes = low_pass(lobes[1], rng)
        self._lean = np.zeros(3) if lean is None else lean
        self._set_profile(control)
        if size is not None:
            for _ in range(_SIZING_ROUNDS):
                control = control * (size / self._diameter_across(), 1.0)
                self._set_profile(control)

    def _set_profile(self, control: Float[np.ndarray, "k 2"]) -> None:
        self.radius = float(control[0, 0])
        self.border_length = _BORDER_FRACTION * self.radius
        self.edge_length = float(np.clip(control[:, 0].max() / 11.0, 0.12 * MM, 0.7 * MM))
        self._r, self._z, length = turned_profile(control)
        self._radial = length / length[-1]
        self._length = float(length[-1])
        self._neck = _neck(self._r)

    def _diameter_across(self) -> float:
        """Maximum diameter across the axis [m], above the neck, on a flat wall."""
        radial, angle = np.meshgrid(
            np.linspace(0.0, 1.0 - 1e-6, 80), np.linspace(-np.pi, np.pi, 73)[:-1]
        )
        direction = np.stack([np.cos(angle.ravel()), np.sin(angle.ravel())], axis=1)
        stretch = 1.0 + self._waviness * self._outline(angle.ravel())
        xy = (radial.ravel() * stretch * self.radius)[:, None] * direction
        normal = np.broadcast_to(self.site.axes[:, 2], (len(xy), 3))
        rest = self.site.center + xy @ self.site.axes[:, :2].T
        points = self.displaced(WallSamples(xy, rest, normal, normal)) - self.site.center
        head = (points @ self.site.axes[:, :2])[radial.ravel() <= self._radial[self._neck]]
        return float(
            scipy.spatial.distance.pdist(head[scipy.spatial.ConvexHull(head).vertices]).max()
        )

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions [m] on the surface of revolution, with lobes."""
        rho, direction, stretch = self.polar(wall)
        radial = np.minimum(rho / (stretch * self.radius), 1.0)
        r = np.interp(radial, self._radial, self._r) * stretch
        z = np.interp(radial, self._radial, self._z)
        outward = direction @ self.site.axes[:, :2].T
        standing = smoothstep((1.0 - radial) / 0.3) * self._upright
        plane = self.site.center + rho[:, None] * outward
        base = mix(wall.rest, plane, standing)
        axis = mix(wall.normal, np.broadcast_to(self.site.axes[:, 2], wall.normal.shape), standing)
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        points = base + (r - rho)[:, None] * outward + z[:, None] * axis
        # The stalk bends; the head is moved rigidly, because shear would widen it.
        neck = max(float(self._z[self._neck]), 1e-9)
        aside = self._z[self._r.argmax()] ** 2 / max(float(np.abs(self._z).max()), 1e-9)
        points += aside * np.clip(z / neck, 0.0, 1.0)[:, None] ** 2 * self._lean
        lobes = self._lobes(points - self.site.center) * self._lobe_height
        lobes *= smoothstep((1.0 - radial) / 0.35)
        points += lobes[:, None] * self._facing(radial, outward, axis)
        return np.where((radial < 1.0)[:, None], points, wall.rest)

    def _facing(self, radial, outward, axis) -> Float[np.ndarray, "n 3"]:
        """Unit normals of the surface of revolution."""
        slope_r = np.interp(radial, self._radial, np.gradient(self._r, self._radial))
        slope_z = np.interp(radial, self._radial, np.gradient(self._z, self._radial))
        norm = np.maximum(np.hypot(slope_r, slope_z), 1e-12)
        return (-slope_z / norm)[:, None] * outward + (slope_r / norm)[:, None] * axis

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Flattened surface with true lengths along the profile [m]."""
        rho, direction, stretch = self.polar(wall)
        rim = stretch * self.radius
        length = np.where(rho < rim, rho / rim * self._length, self._length + (rho - rim))
        return length[:, None] * direction


def _neck(r: Float[np.ndarray, " n"]) -> int:
    """Profile sample, from the top, where the head meets its stalk; the last without a stalk."""
    below = np.flatnonzero((r < 0.5 * r.max()) & (np.arange(len(r)) > r.argmax()))
    return int(below[0]) if len(below) else len(r) - 1


def turned_profile(
    control: Float[np.ndarray, "k 2"],
) -> tuple[Float[np.ndarray, " 400"], Float[np.ndarray, " 400"], Float[np.ndarray, " 400"]]:
    """Distance from the axis, height, and length along the profile [m], from the top to the rim."""
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, len(control) - 2), [1.0] * 3])
    r, z = scipy.interpolate.BSpline(knots, control[::-1], 3)(np.linspace(0.0, 1.0, 400)).T
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))])
    return r, z, length
