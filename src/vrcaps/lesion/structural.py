"""Structural lesions of the whole wall: tumor masses, diverticula, strictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from vrcaps.core.color import mix
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import CM, MM
from vrcaps.lesion.base import AppearanceSample, Lesion, LesionSite, SizedLesion, WallSamples
from vrcaps.lesion.focal import ProfileForm, under_blood
from vrcaps.mesh.noise import band_pass, fbm, low_pass

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.organ.surface import OrganSurface

# fmt: off
# Distance from the axis and height, in radii: a rolled edge around an ulcerated middle.
_MASS = (
    (1.0, 0.0), (0.94, 0.0), (0.92, 0.08), (1.02, 0.42), (0.78, 0.78),
    (0.52, 0.66), (0.36, 0.4), (0.18, 0.34), (0.0, 0.34),
)
# A neck, and a pouch wider than it.
_POUCH = (
    (1.45, 0.0), (1.2, 0.0), (1.02, -0.12), (0.95, -0.6),
    (1.5, -0.9), (1.6, -2.0), (0.9, -2.6), (0.0, -2.6),
)
# fmt: on


@dataclass(frozen=True, kw_only=True)
class Tumor(SizedLesion):
    """Ulcerated mass with a rolled edge, like a cancer of Borrmann type 2.

    Attributes:
        size: Diameter [m], 10 to 50 mm.
    """

    size: Annotated[float, Range(10.0 * MM, 50.0 * MM, unit="m")] = 25.0 * MM

    kind: ClassVar[str] = "tumor"

    @property
    def protrusion(self) -> float:
        """Height of its edge [m]."""
        return 0.4 * self.size

    def form(self, site: LesionSite, rng: np.random.Generator) -> TumorForm:
        """Draw the irregularities."""
        return TumorForm(self, site, rng)


class TumorForm(ProfileForm):
    """Lobed ring of tumor around a bleeding, necrotic crater."""

    def __init__(self, tumor: Tumor, site: LesionSite, rng: np.random.Generator) -> None:
        size = tumor.size
        super().__init__(
            site,
            np.array(_MASS) * 0.5 * size,
            rng,
            waviness=0.16,
            upright=False,
            lobes=(0.035 * size, 0.24 * size),
        )
        self._necrosis, self._grain = fbm(0.22 * size, rng), band_pass(1.1 * MM, rng)
        self._blood = fbm(0.2 * size, rng)

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint dark red, friable tissue, and slough and blood in the crater."""
        radial, fine = self.normalized_radius(wall), np.tanh(self._grain(points))
        color = clean.plain * (0.90, 0.50, 0.46)
        color = color * np.exp(0.16 * fine + 0.10 * self._blood(points))[:, None]
        crater = smoothstep((0.5 - radial) / 0.25)
        dead = smoothstep((self._necrosis(points) + 1.6 * crater - 1.1) / 0.5)
        slough = np.array([0.42, 0.40, 0.26]) * np.exp(0.15 * fine)[:, None]
        color = mix(color, slough, 0.85 * dead)
        bleeding = smoothstep((self._blood(points) + 0.8 * crater - 1.3) / 0.3)
        color = under_blood(color, 0.8 * MM * bleeding, 0.3)
        look = (color, clean.roughness - 0.25 * bleeding + 0.08 * dead, 0.05 * MM * fine)
        return self.blended(wall, clean, look, softness=0.1)


@dataclass(frozen=True, kw_only=True)
class Diverticulum(SizedLesion):
    """Outward pouch of the lumen through a gap in its muscle.

    Attributes:
        size: Diameter of its mouth [m], 2 to 15 mm.
    """

    size: Annotated[float, Range(2.0 * MM, 15.0 * MM, unit="m")] = 6.0 * MM

    kind: ClassVar[str] = "diverticulum"
    notes: ClassVar[Mapping[str, str]] = {"size": "of its mouth 2 to 15 mm"}

    @property
    def footprint_radius(self) -> float:
        """Radius of the wall that becomes the pouch [m]."""
        return 0.5 * self.size * _POUCH[0][0]

    @property
    def head_radius(self) -> float:
        """Radius of the pouch [m]."""
        return 0.5 * self.size * max(r for r, z in _POUCH if z < -0.5)

    @property
    def protrusion(self) -> float:
        """Depth of the pouch, negative [m]."""
        return 0.5 * self.size * min(z for _, z in _POUCH)

    def form(self, site: LesionSite, rng: np.random.Generator) -> DiverticulumForm:
        """Draw the irregularities."""
        return DiverticulumForm(self, site, rng)


class DiverticulumForm(ProfileForm):
    """Pouch lined by thin mucosa."""

    def __init__(self, pouch: Diverticulum, site: LesionSite, rng: np.random.Generator) -> None:
        size = pouch.size
        super().__init__(
            site,
            np.array(_POUCH) * 0.5 * size,
            rng,
            waviness=0.08,
            upright=True,
            lobes=(0.01 * size, 0.6 * size),
        )

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint a slightly redder and darker interior."""
        inside = smoothstep((0.75 - self.normalized_radius(wall)) / 0.3)
        color = clean.color * (1.0 - inside[:, None] * (0.12, 0.25, 0.25))
        return self.blended(wall, clean, (color, clean.roughness, clean.height), softness=0.2)


@dataclass(frozen=True, kw_only=True)
class Stricture(Lesion):
    """Scarred narrowing of the whole circumference.

    Attributes:
        length: Length along the lumen [m], 5 to 100 mm.
        narrowing: Reduction of the lumen's diameter as a fraction, 0.2 to 0.85.
    """

    length: Annotated[float, Range(5.0 * MM, 100.0 * MM, unit="m")] = 25.0 * MM
    narrowing: Annotated[float, Range(0.2, 0.85)] = 0.55

    kind: ClassVar[str] = "stricture"
    notes: ClassVar[Mapping[str, str]] = {"narrowing": "0.2 to 0.85 of the diameter"}

    @property
    def extent(self) -> Literal["circumferential"]:
        """Strictures affect the whole circumference."""
        return "circumferential"

    def arc_length_range(self, organ: OrganSurface, middle: float | None) -> tuple[float, float]:
        """First and last arc length [m].

        Raises:
            InputError: If it reaches beyond the organ's ends.
        """
        at, length = middle or 0.0, organ.centerline.length
        low, high = at - 0.5 * self.length, at + 0.5 * self.length
        if not 0.0 < low < high < length:
            raise InputError(
                f"A stricture at {at / CM:.1f} cm reaches beyond the organ's end (length "
                f"{length / CM:.1f} cm). Give an arc_length farther inside."
            )
        return low, high

    def form(self, site: LesionSite, rng: np.random.Generator) -> StrictureForm:
        """Draw the irregularities."""
        return StrictureForm(self, site, rng)


class StrictureForm:
    """Wall contracted towards the centerline, scarred and without folds."""

    edge_length = 1.2 * MM
    border_length = 0.35 * MM

    def __init__(self, stricture: Stricture, site: LesionSite, rng: np.random.Generator) -> None:
        self.stricture, self.site = stricture, site
        self._uneven, self._scar = low_pass(9.0 * MM, rng), fbm(6.0 * MM, rng)

    def signed_distance(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance within its ends [m]."""
        low, high = self.site.arc_length_range
        ragged = 0.03 * self.stricture.length * self._uneven(wall.rest)
        return np.minimum(wall.xy[:, 0] - low, high - wall.xy[:, 0]) + ragged

    def _tightness(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Degree of narrowing, from 0 at the ends to 1 in the middle."""
        return smoothstep(self.signed_distance(wall) / (0.42 * self.stricture.length))

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Contracted positions [m]."""
        tight = self.stricture.narrowing * self._tightness(wall)
        tight = tight * (1.0 + 0.06 * self._uneven(wall.rest))
        return wall.rest + np.clip(tight, 0.0, 0.9)[:, None] * wall.inward

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Unused: the stricture is painted in place."""
        return wall.xy

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint a pale scar without vessels, with red edges."""
        tight = self._tightness(wall)
        scar = smoothstep(0.5 + 0.6 * self._scar(points)) * tight
        color = mix(clean.color, clean.plain, tight)
        color = color * (1.0 - (tight * (1.0 - tight))[:, None] * (0.1, 1.2, 1.2))
        color = mix(color, np.array([0.52, 0.38, 0.34]), 0.55 * scar)
        return replace(
            clean,
            color=np.clip(color, 0.0, 1.0),
            roughness=clean.roughness,
            height=clean.height * (1.0 - 0.5 * tight),
        )
