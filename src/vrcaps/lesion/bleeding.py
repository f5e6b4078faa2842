"""Bleeding: from petechiae to blood that runs down the wall and collects in hollows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from vrcaps.core.color import mix
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.lesion.base import AppearanceSample, BloodFlow, Form, Lesion, LesionSite, WallSamples
from vrcaps.lesion.focal import FocalForm, under_blood
from vrcaps.mesh.noise import fbm, low_pass

if TYPE_CHECKING:
    from jaxtyping import Float

_STAIN = 0.05 * MM
"""Minimum thickness of blood within its outline."""

_OPEN = 8.0 * MM
"""Radius of the lumen kept free of a pool, so that a capsule can pass."""

_SHORE = 2.0 * MM
"""Distance along the wall beyond the hollow's vertices that contains the pool's edge [m]."""


BLEEDING_SEVERITIES = {
    1: BloodFlow(7.0 * MM),
    2: BloodFlow(1.6 * MM, 35.0 * MM, 0.9 * MM, 0.25 * MM),
    3: BloodFlow(3.0 * MM, 90.0 * MM, 2.0 * MM, 0.4 * MM, 2.5 * MM, 0.4 * MM),
    4: BloodFlow(6.0 * MM, 160.0 * MM, 4.5 * MM, 0.6 * MM, 6.0 * MM, 1.2 * MM),
}
"""Project-specific scale: 1 petechiae under the mucosa, 2 oozing with a trickle, 3 a flow
that collects in the nearest hollow, 4 a broad flow, a deep pool and clots."""


@dataclass(frozen=True, kw_only=True)
class Bleeding(Lesion):
    """Bleeding; blood runs with gravity.

    Attributes:
        severity: 1 petechiae, 2 oozing, 3 streaming, 4 massive.
    """

    severity: Literal[1, 2, 3, 4] = 3

    kind: ClassVar[str] = "bleeding"
    grade_field: ClassVar[str] = "severity"
    grade_meanings: ClassVar[Mapping[str, str]] = {
        "1": "petechiae",
        "2": "oozing",
        "3": "streaming",
        "4": "massive",
    }
    notes: ClassVar[Mapping[str, str]] = {"": "flows with gravity, so with `--posture`"}

    @classmethod
    def library(cls) -> dict[str, Lesion]:
        """The 40 cases of bleeding of the VR-Caps paper, 10 of each severity."""
        severities: tuple[Any, ...] = tuple(BLEEDING_SEVERITIES)
        return {
            f"bleeding-{severity}-{number:02d}": cls(severity=severity, variant=number)
            for severity in severities
            for number in range(1, 11)
        }

    @property
    def extent(self) -> Literal["focal", "flow"]:
        """Petechiae are focal, all other grades flow."""
        return "focal" if self.severity == 1 else "flow"

    @property
    def grade(self) -> str:
        """Severity, 1 to 4."""
        return f"grade {self.severity}"

    @property
    def footprint_radius(self) -> float:
        """Radius of the bleeding source [m]."""
        return BLEEDING_SEVERITIES[self.severity].source

    @property
    def flow(self) -> BloodFlow:
        """Dimensions of the flow."""
        return BLEEDING_SEVERITIES[self.severity]

    def form(self, site: LesionSite, rng: np.random.Generator) -> Form:
        """Draw the irregularities."""
        if self.severity == 1:
            return PetechiaeForm(site, self.flow.source, rng)
        return BleedingForm(self.flow, site, rng)


class PetechiaeForm(FocalForm):
    """Bleeding points under the mucosa, denser towards the center."""

    def __init__(self, site: LesionSite, radius: float, rng: np.random.Generator) -> None:
        super().__init__(site, radius, rng, waviness=0.2)
        self._points, self._blush = low_pass(1.5 * MM, rng), fbm(4.0 * MM, rng)

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint red points of about a millimeter on a blush."""
        crowd = 1.0 - self.normalized_radius(wall) ** 2
        blush = smoothstep(crowd + 0.3 * self._blush(points))
        color = clean.color * (1.0 - blush[:, None] * (0.03, 0.30, 0.30))
        density = self._points(points) + 0.9 * crowd
        point = smoothstep((density - 1.35) / 0.5)
        color = mix(color, np.array([0.21, 0.026, 0.019]), 0.92 * point)
        look = (color, clean.roughness - 0.1 * point, clean.height)
        return self.blended(wall, clean, look, softness=0.25)


class BleedingForm:
    """Blood from a source along its path down, and the resulting pool."""

    edge_length = 1.2 * MM

    def __init__(self, flow: BloodFlow, site: LesionSite, rng: np.random.Generator) -> None:
        self.border_length = 0.05 * flow.width
        self.flow, self.site = flow, site
        self._edge, self._ripple = low_pass(7.0 * MM, rng), fbm(5.0 * MM, rng)
        self._clots, self._age = low_pass(4.0 * MM, rng), fbm(9.0 * MM, rng)

    def _pool(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Depth of the pool [m]; negative above it, outside its hollow or far from its bottom."""
        if self.flow.pool == 0.0 or self.site.bottom is None:
            return np.full(len(wall.xy), -1.0)
        under = (wall.rest - self.site.bottom) @ self.site.down + self.flow.pool
        away = np.linalg.norm(wall.rest - self.site.bottom, axis=1)
        shore = self.flow.pool * (1.0 - wall.xy[:, 2] / _SHORE)
        return np.minimum(np.minimum(under, self.site.reach - away), shore)

    def _dry(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance within the outline of source and flow [m]."""
        wave = 1.0 + 0.22 * self._edge(wall.rest)
        source = self.flow.source * wave - np.linalg.norm(wall.rest - self.site.center, axis=1)
        swelling = 1.0 - np.exp(-wall.xy[:, 0] / (12.0 * MM)) * 0.45
        return np.maximum(source, self.flow.width * wave * swelling - wall.xy[:, 1])

    def signed_distance(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance within the blood's outline, or depth of the pool [m]."""
        return np.maximum(self._dry(wall), self._pool(wall))

    def _film(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Thickness of the blood outside the pool [m]."""
        within = np.clip(self._dry(wall) / (0.7 * self.flow.width), 0.0, 1.0)
        clots = np.clip(self._clots(wall.rest) - 0.4, 0.0, 1.2) * self.flow.clots
        near = np.exp(-((wall.xy[:, 0] / (5.0 * self.flow.source)) ** 2))
        return np.sqrt(within) * (self.flow.film + clots * (0.25 + 0.75 * near))

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions of the blood's surface [m].

        The surface of the pool is level: each point below it moves there towards the centerline, so
        that overhanging walls do not fold, but stops before the lumen is blocked.
        """
        film, pool = self._film(wall)[:, None] * wall.normal, self._pool(wall)
        reach = np.maximum(np.linalg.norm(wall.inward, axis=1), 1e-9)
        inward = wall.inward / reach[:, None]
        steep = np.maximum(-inward @ self.site.down, 0.3)
        free = np.maximum(reach - _OPEN, 0.0)
        surface = wall.rest + np.minimum(np.maximum(pool, 0.0) / steep, free)[:, None] * inward
        wet = smoothstep(pool / (1.0 * MM))
        clots = np.clip(self._clots(surface) - 0.9, 0.0, 1.5) * self.flow.clots * wet
        return surface + clots[:, None] * inward + (1.0 - wet)[:, None] * film

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Unused: blood is painted in place."""
        return wall.xy

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint blood over the mucosa: fresh at the source, darker and clotted farther down."""
        pool = np.maximum(self._pool(wall), 0.0)
        within = np.clip(self._dry(wall) / (0.9 * self.flow.width), 0.0, 1.0)
        film = self._film(wall) * within * (0.8 + 0.35 * np.tanh(self._ripple(points)))
        thickness = film + _STAIN * smoothstep(self._dry(wall) / (0.3 * MM)) + pool
        farther = wall.xy[:, 0] / max(self.flow.run, 1e-9)
        clotted = self.flow.clots / (2.0 * MM)
        age = smoothstep(0.3 * self._age(points) + 0.6 * farther + clotted - 0.1)
        color = under_blood(clean.color, thickness, 0.9 * age)
        wet = np.maximum(smoothstep(within / 0.5), smoothstep(pool / (0.4 * MM)))
        ripple = 0.03 * MM * self._ripple(points)
        return replace(
            clean,
            color=np.clip(color, 0.0, 1.0),
            roughness=clean.roughness + (0.16 - clean.roughness) * wet,
            height=clean.height * (1.0 - wet) + ripple * wet,
        )
