"""Mucosal lesions: erosions, ulcers, and dilated blood and lymph vessels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.core.color import mix
from vrcaps.core.fields import Range
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.lesion.base import AppearanceSample, LesionSite, Setting, SizedLesion, WallSamples
from vrcaps.lesion.focal import FIBRIN, FocalForm, under_blood
from vrcaps.mesh.noise import band_pass, fbm, low_pass

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class MucosalBreak:
    """Parameters of a kind of mucosal break.

    Attributes:
        base: Radius of the open base as a fraction of the total radius.
        deep: Depth [m].
        rim: Height of its swollen rim [m].
        halo: Redness around the break.
        waviness: Waviness of the outline.
        blood: Probability of a blood clot on its base, 0 to 1.
    """

    base: float
    deep: float
    rim: float
    halo: float
    waviness: float
    blood: float


MUCOSAL_BREAKS = {
    "erosion": MucosalBreak(0.40, 0.15 * MM, 0.0, 0.9, 0.22, 0.3),
    "aphthous": MucosalBreak(0.42, 0.4 * MM, 0.25 * MM, 1.0, 0.06, 0.0),
    "deep": MucosalBreak(0.6, 2.2 * MM, 0.7 * MM, 0.6, 0.2, 0.6),
}
"""An aphthous ulcer is small, round, with a white base and a red halo; a deep one is wide,
irregular and sloughy, with a raised edge. They reach into the submucosa, an erosion does not."""

_SIZES = {
    "aphthous": Range(2.0 * MM, 10.0 * MM, unit="m"),
    "deep": Range(5.0 * MM, 40.0 * MM, unit="m"),
}
"""Diameters by type [m]."""

_SLOUGH = np.array([0.36, 0.245, 0.08])
"""Linear reflectance of necrotic slough, yellow with bile."""

_GRANULATION = np.array([0.35, 0.12, 0.082])
"""Linear reflectance of granulation tissue, without slough."""


@dataclass(frozen=True, kw_only=True)
class Erosion(SizedLesion):
    """Superficial break of the mucosa.

    Attributes:
        size: Diameter including the red surroundings [m], 1 to 10 mm.
    """

    size: Annotated[float, Range(1.0 * MM, 10.0 * MM, unit="m")] = 4.0 * MM

    kind: ClassVar[str] = "erosion"

    def form(self, site: LesionSite, rng: np.random.Generator) -> MucosalBreakForm:
        """Draw the irregularities."""
        return MucosalBreakForm(MUCOSAL_BREAKS["erosion"], site, 0.5 * self.size, rng)


@dataclass(frozen=True, kw_only=True)
class Ulcer(SizedLesion):
    """Ulcer.

    Attributes:
        type: Aphthous or deep.
        size: Diameter including the red surroundings [m]: aphthous 2 to 10 mm, deep 5 to 40 mm.
    """

    type: Literal["aphthous", "deep"] = "deep"
    size: Annotated[float, Range(2.0 * MM, 40.0 * MM, unit="m")] = 8.0 * MM

    kind: ClassVar[str] = "ulcer"
    grade_field: ClassVar[str] = "type"
    notes: ClassVar[Mapping[str, str]] = {"size": "aphthous 2 to 10 mm, deep 5 to 40 mm"}

    def __post_init__(self) -> None:
        super().__post_init__()
        size = Setting("size", (), _SIZES[self.type], is_text=False, is_integer=False)
        size.check(self.size, f"{self.type} ulcer")

    def form(self, site: LesionSite, rng: np.random.Generator) -> MucosalBreakForm:
        """Draw the irregularities."""
        return MucosalBreakForm(MUCOSAL_BREAKS[self.type], site, 0.5 * self.size, rng)


class MucosalBreakForm(FocalForm):
    """Crater with a rim, fibrin on its base, and redness around it."""

    def __init__(
        self, kind: MucosalBreak, site: LesionSite, radius: float, rng: np.random.Generator
    ) -> None:
        super().__init__(site, radius, rng, waviness=kind.waviness)
        self.kind = kind
        self._deep = min(kind.deep, 0.3 * radius)
        self._rim = min(kind.rim, 0.12 * radius)
        self._slough, self._grain = fbm(max(0.4 * radius, 0.8 * MM), rng), band_pass(0.7 * MM, rng)
        self._is_bloody = rng.random() < kind.blood
        self._granulation = fbm(max(0.25 * radius, 0.6 * MM), rng)
        self._uneven = 0.03 * self._deep  # RMS height of its base

    def _open(self, wall: WallSamples, points: Float[np.ndarray, "n 3"]):
        """Openness, from 0 outside the break to 1 on its base."""
        ragged = self.normalized_radius(wall) + 0.06 * self._slough(points)
        return smoothstep((self.kind.base - ragged) / 0.14 + 0.5)

    def height(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Height [m] of the depressed base and the raised rim."""
        radial = self.normalized_radius(wall)
        base = smoothstep((self.kind.base - radial) / 0.22 + 0.5)
        rim = np.exp(-(((radial - self.kind.base - 0.12) / 0.14) ** 2))
        return self._rim * rim * smoothstep((1.0 - radial) / 0.2) - self._deep * base

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint fibrin, slough, granulation and blood on the base, and a red halo around it."""
        radial, base = self.normalized_radius(wall), self._open(wall, points)
        fine = self._grain(points)
        halo = self.kind.halo * smoothstep((1.0 - radial) / 0.5)
        color = mix(clean.color, clean.plain, 0.8 * halo)
        color = color * (1.0 - halo[:, None] * (0.10, 0.75, 0.75))
        slough = smoothstep(0.5 + 0.5 * self._slough(points))
        floor = mix(1.15 * np.broadcast_to(FIBRIN, color.shape), _SLOUGH, slough)
        bare = smoothstep((self._granulation(points) + 0.8 * radial / self.kind.base - 1.1) / 0.9)
        floor = mix(floor, _GRANULATION, 0.75 * bare)
        color = mix(color, floor * np.exp(0.06 * fine)[:, None], 0.92 * base)
        if self._is_bloody:
            clot = smoothstep((self._slough(points[:, ::-1]) - 1.0) / 0.3) * base
            color = under_blood(color, 0.5 * MM * clot, 0.4)
        uneven = 0.02 * MM * fine + self._uneven * self._granulation(points)
        look = (color, clean.roughness, clean.height * (1.0 - base) + uneven * base)
        return self.blended(wall, clean, look, softness=0.3)


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
