"""Angioectasia and lymphangiectasia: dilated blood and lymph vessels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.config.limits import Range
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.lesion.base import (
    AppearanceSample,
    LesionSite,
    SizedLesion,
    WallSamples,
    mix,
)
from vrcaps.lesion.focal import FocalForm
from vrcaps.mesh.noise import band_pass, fbm, low_pass

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class Angioectasia(SizedLesion):
    """Flat, bright red lesion of dilated capillaries with fern-like edges.

    Attributes:
        size: Diameter [m], 1 to 15 mm.
    """

    size: Annotated[float, Range(1.0 * MM, 15.0 * MM, unit="m")] = 5.0 * MM

    kind: ClassVar[str] = "angioectasia"

    def form(self, site: LesionSite, rng: np.random.Generator) -> AngioectasiaForm:
        """Draw the vessels."""
        return AngioectasiaForm(site, 0.5 * self.size, rng)


class AngioectasiaForm(FocalForm):
    """Winding capillaries that merge in the center."""

    def __init__(self, site: LesionSite, radius: float, rng: np.random.Generator) -> None:
        super().__init__(site, radius, rng, waviness=0.3)
        self._vessels = [band_pass(w, rng) for w in (0.32 * radius + 0.3 * MM, 0.5 * MM)]
        self._blotch = fbm(0.8 * radius, rng)

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint bright red capillaries and a blush between them."""
        crowd = np.clip(1.0 - self.normalized_radius(wall) + 0.12 * self._blotch(points), 0.0, 1.0)
        width = 0.10 + 0.75 * crowd**1.5
        winding = np.minimum(*(np.abs(field(points)) for field in self._vessels))
        vessel = smoothstep((width - winding) / 0.12 + 0.5)
        color = clean.color * (1.0 - crowd[:, None] * (0.0, 0.35, 0.35))
        color = mix(color, np.array([0.35, 0.032, 0.034]), 0.9 * vessel)
        look = (color, clean.roughness, clean.height + 0.01 * MM * vessel)
        return self.blended(wall, clean, look, softness=0.25)


@dataclass(frozen=True, kw_only=True)
class Lymphangiectasia(SizedLesion):
    """White to yellow tips over dilated lymph vessels, clustered or scattered.

    Attributes:
        size: Diameter of the cluster [m], 2 to 30 mm.
    """

    size: Annotated[float, Range(2.0 * MM, 30.0 * MM, unit="m")] = 12.0 * MM

    kind: ClassVar[str] = "lymphangiectasia"

    @property
    def protrusion(self) -> float:
        """Height of the swollen tips [m]."""
        return 0.8 * MM

    def form(self, site: LesionSite, rng: np.random.Generator) -> LymphangiectasiaForm:
        """Draw the tips."""
        return LymphangiectasiaForm(site, 0.5 * self.size, rng)


class LymphangiectasiaForm(FocalForm):
    """Swollen white tips."""

    def __init__(self, site: LesionSite, radius: float, rng: np.random.Generator) -> None:
        super().__init__(site, radius, rng, waviness=0.25)
        self.edge_length = 0.3 * MM
        self._tips, self._crowd = low_pass(1.6 * MM, rng), fbm(radius, rng)

    def _raised(self, wall: WallSamples, points: Float[np.ndarray, "n 3"]):
        crowd = 1.1 * np.clip(1.0 - self.normalized_radius(wall), 0.0, 1.0) + 0.25 * self._crowd(
            points
        )
        return smoothstep((self._tips(points) + crowd - 0.75) / 0.8)

    def height(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Height of the tips, half a millimeter over the wall [m]."""
        fade = smoothstep((1.0 - self.normalized_radius(wall)) / 0.2)
        return 0.5 * MM * self._raised(wall, wall.rest - self.site.center) * fade

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint white chyle that shines through the tips."""
        tip = self._raised(wall, wall.rest - self.site.center)
        color = mix(clean.color, np.array([0.66, 0.66, 0.58]), 0.85 * tip)
        return self.blended(wall, clean, (color, clean.roughness, clean.height), softness=0.15)
