"""Ulcerative colitis: continuous inflammation upwards from the rectum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.core.color import mix
from vrcaps.core.fields import Range
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import CM, MM
from vrcaps.lesion.base import AppearanceSample, Lesion, LesionSite, WallSamples
from vrcaps.lesion.focal import FIBRIN, under_blood
from vrcaps.mesh.noise import band_pass, fbm, low_pass
from vrcaps.mucosa.mucosa import MUCUS_TINT

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.organ.surface import OrganSurface

_EXTENTS = {"E1": ("rectum", 15 * CM), "E2": ("descending", 60 * CM), "E3": ("ascending", np.inf)}
"""Montreal classes (Silverberg et al. 2005): proctitis, left-sided, extensive. First affected
segment, and the length from the anal end for organs without this segment [m]."""

_FADE = 12.0 * MM
"""Width of the transition from healthy to fully inflamed at the ends."""

_FILM = 0.35 * MM
"""Thickness of blood where the field that distributes it exceeds its threshold by one deviation."""


_MUCOPUS_DEPTH = 1.1
"""Scattering depth of mucopus where its field exceeds the threshold by one deviation."""


@dataclass(frozen=True)
class Activity:
    """Appearance of a Mayo endoscopic subscore (Schroeder, Tremaine and Ilstrup 1987).

    Attributes:
        obscured: Degree to which the vessels have faded, 0 to 1.
        tint: Reflectance ratio of inflamed to plain mucosa: red, green, blue.
        patchiness: Fraction of the redness in patches.
        granularity: RMS height of the granular relief [m].
        stipple: Standard deviation of the optical density of granules, equal in all colors.
        petechiae: Threshold of the field that positions bleeding points, in deviations.
        erosions: Threshold for small erosions.
        ulcers: Threshold for wide ulcers.
        blood: Threshold for films of blood.
        mucopus: Threshold for bile-stained films of mucus and pus over everything else.
    """

    obscured: float
    tint: tuple[float, float, float]
    patchiness: float
    granularity: float
    stipple: float = 0.07
    petechiae: float = np.inf
    erosions: float = np.inf
    ulcers: float = np.inf
    blood: float = np.inf
    mucopus: float = np.inf


ACTIVITIES = {
    1: Activity(
        obscured=0.92,
        tint=(0.995, 0.510, 0.308),
        patchiness=0.85,
        granularity=0.014 * MM,
        stipple=0.14,
        petechiae=3.2,
        mucopus=1.5,
    ),
    2: Activity(
        obscured=1.0,
        tint=(0.975, 0.707, 0.796),
        patchiness=0.7,
        granularity=0.017 * MM,
        petechiae=2.6,
        erosions=1.4,
        mucopus=1.2,
    ),
    3: Activity(
        obscured=1.0,
        tint=(0.955, 0.387, 0.254),
        patchiness=0.5,
        granularity=0.020 * MM,
        petechiae=2.3,
        erosions=1.3,
        ulcers=0.6,
        blood=0.6,
        mucopus=1.0,
    ),
}
"""By Mayo subscore: 1 erythema, decreased vascular pattern; 2 marked erythema, no vascular
pattern, friability, erosions; 3 spontaneous bleeding, ulceration. Tints were fitted to the mean
color of real frames of each subscore under an ideal camera; the few real frames of subscore 2 are
paler and less yellow than those of 1, due to other cameras as much as to disease."""


@dataclass(frozen=True, kw_only=True)
class Colitis(Lesion):
    """Ulcerative colitis.

    Attributes:
        mayo: Mayo endoscopic subscore.
        spread: Extent up from the anal end: E1 (rectum), E2 (left colon), E3 (beyond),
            or a length [m]. A length with a location is centered on that location instead.
    """

    mayo: Literal[1, 2, 3] = 2
    spread: Literal["E1", "E2", "E3"] | Annotated[float, Range(1 * CM, 300 * CM, unit="m")] = "E1"

    kind: ClassVar[str] = "colitis"
    grade_field: ClassVar[str] = "mayo"
    grade_scale: ClassVar[str] = "Mayo"
    notes: ClassVar[Mapping[str, str]] = {
        "spread": "from the anal end: E1, E2, E3 (Montreal) or 10 to 3000 mm"
    }

    @classmethod
    def library(cls) -> dict[str, Lesion]:
        """The 60 cases of colitis of the VR-Caps paper, 20 of each Mayo subscore."""
        subscores: tuple[Any, ...] = tuple(ACTIVITIES)
        return {
            f"colitis-{mayo}-{number:02d}": cls(
                mayo=mayo, spread=(6.0 + 3.0 * ((7 * number) % 20)) * CM, variant=number
            )
            for mayo in subscores
            for number in range(1, 21)
        }

    @property
    def extent(self) -> Literal["circumferential"]:
        """Colitis affects the whole circumference."""
        return "circumferential"

    @property
    def grade(self) -> str:
        """Mayo subscore."""
        return f"Mayo {self.mayo}"

    def arc_length_range(self, organ: OrganSurface, middle: float | None) -> tuple[float, float]:
        """First and last arc length [m]."""
        length = organ.centerline.length
        if isinstance(self.spread, str):
            segment, reach = _EXTENTS[self.spread]
            is_first = organ.label == (
                organ.label_names.index(segment) if segment in organ.label_names else -1
            )
            low = organ.arc_length[is_first].min() if is_first.any() else length - reach
            return max(float(low), -np.inf), np.inf
        if middle is None:
            return length - self.spread, np.inf
        return middle - 0.5 * self.spread, middle + 0.5 * self.spread

    def form(self, site: LesionSite, rng: np.random.Generator) -> ColitisForm:
        """Draw the irregularities."""
        return ColitisForm(self, site, rng)


class ColitisForm:
    """Colitis with its irregularities drawn: the surface changes, not the shape."""

    edge_length = np.inf
    border_length = 0.35 * MM

    def __init__(self, colitis: Colitis, site: LesionSite, rng: np.random.Generator) -> None:
        self.activity, self.site = ACTIVITIES[colitis.mayo], site
        self._ragged, self._patches = low_pass(16.0 * MM, rng), fbm(14.0 * MM, rng)
        self._granules, self._points = band_pass(0.8 * MM, rng), low_pass(1.1 * MM, rng)
        self._mottle = fbm(2.5 * MM, rng)
        self._erosions, self._ulcers = fbm(5.0 * MM, rng), fbm(18.0 * MM, rng)
        self._blood = fbm(12.0 * MM, rng)
        self._mucopus = fbm(14.0 * MM, rng)

    def signed_distance(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance within the ragged ends of the range [m]."""
        low, high = self.site.arc_length_range
        ragged = 3.0 * MM * self._ragged(wall.rest)
        return np.minimum(wall.xy[:, 0] - low, high - wall.xy[:, 0]) + ragged

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions, unchanged."""
        return wall.rest

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Unused: colitis is painted in place."""
        return wall.xy

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint redness, granules, bleeding points, erosions, ulcers and blood."""
        is_like, inside = self.activity, smoothstep(self.signed_distance(wall) / _FADE)
        mottle, granules = self._mottle(points), np.tanh(1.3 * self._granules(points))
        patch = smoothstep(0.5 + 0.4 * self._patches(points) + 0.15 * mottle)
        redness = (1.0 - is_like.patchiness) + is_like.patchiness * patch
        color = mix(clean.color, clean.plain, is_like.obscured * (0.8 + 0.2 * patch))
        color = color * np.array(is_like.tint) ** redness[:, None]
        color = color * np.exp(is_like.stipple * granules + 0.06 * mottle)[:, None]
        point = smoothstep((self._points(points) - is_like.petechiae) / 0.6)
        color = mix(color, np.array([0.25, 0.046, 0.046]), 0.6 * point)
        height = clean.height * (1.0 - 0.5 * is_like.obscured) + is_like.granularity * granules
        color, sloughy, height = self._ulcerated(color, height, points, mottle)
        pooled = np.zeros_like(mottle)
        if np.isfinite(is_like.blood):
            pooled = np.clip(self._blood(points) + 0.3 * mottle - is_like.blood, 0.0, 2.0)
            color = under_blood(color, _FILM * pooled**1.5 * np.exp(0.25 * granules), 0.3 * pooled)
        thick = np.clip(self._mucopus(points) + 0.3 * mottle - is_like.mucopus, 0.0, 2.0)
        cover = 1.0 - np.exp(-_MUCOPUS_DEPTH * thick * np.exp(0.3 * granules))
        color = mix(color, clean.plain * np.array(MUCUS_TINT), cover)
        wet = smoothstep(pooled + thick)
        rough = clean.roughness + 0.10 * sloughy - 0.2 * wet
        return replace(
            clean,
            color=np.clip(mix(clean.color, color, inside), 0.0, 1.0),
            roughness=clean.roughness + (rough - clean.roughness) * inside,
            height=clean.height + (height * (1.0 - 0.6 * wet) - clean.height) * inside,
        )

    def _ulcerated(self, color, height, points, mottle):
        """Paint fibrin in mucosal breaks and redder surroundings."""
        sloughy = np.zeros(len(points))
        for field, threshold, deep in (
            (self._erosions, self.activity.erosions, 0.04 * MM),
            (self._ulcers, self.activity.ulcers, 0.20 * MM),
        ):
            if not np.isfinite(threshold):
                continue
            excess = field(points) - threshold + 0.3 * mottle
            rim = np.exp(-(((excess + 0.1) / 0.4) ** 2))
            color = color * (1.0 - rim[:, None] * (0.05, 0.22, 0.22))
            base = smoothstep((excess + 0.2) / 1.3)
            slough = FIBRIN * np.exp(0.10 * mottle + 0.15 * self._patches(points))[:, None]
            color = mix(color, slough, 0.6 * base)
            height = height + (0.3 * rim - base) * deep
            sloughy = np.maximum(sloughy, base)
        return color, sloughy, height
