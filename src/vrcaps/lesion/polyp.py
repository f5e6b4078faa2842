"""Polyps: shapes of the Paris classification with five kinds of surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.core.color import mix
from vrcaps.core.fields import Range
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM
from vrcaps.lesion.base import AppearanceSample, Lesion, LesionSite, SizedLesion, WallSamples
from vrcaps.lesion.focal import FIBRIN, ProfileForm, under_blood
from vrcaps.mesh.noise import band_pass, fbm

if TYPE_CHECKING:
    from jaxtyping import Float

PATTERNS = ("tubular", "villous", "serrated", "hyperplastic", "inflammatory")
"""Kinds of surface, named after the associated histology."""

# Profiles from the rim of the footprint to the top, as control points of a cubic B-spline:
# distance from the axis and height, in radii of the head. Height over width as in the drawings of
# the Paris workshop: Is is higher than a closed forceps (2.5 mm), IIa lower, IIc is depressed.
# fmt: off
_PROFILES = {
    "Ip": (
        (0.66, 0.0), (0.48, 0.0), (0.36, 0.06), (0.33, 0.35), (0.33, 0.8), (0.34, 1.1),
        (0.6, 0.98), (1.02, 1.0), (1.18, 1.75), (1.0, 2.55), (0.45, 2.85), (0.0, 2.85),
    ),
    "Is": (
        (1.05, 0.0), (0.93, 0.0), (0.88, 0.05), (0.9, 0.3), (1.1, 0.75),
        (0.92, 1.3), (0.42, 1.42), (0.0, 1.42),
    ),
    "IIa": ((1.0, 0.0), (0.96, 0.0), (0.93, 0.02), (0.93, 0.26), (0.75, 0.32), (0.0, 0.34)),
    "IIb": ((1.0, 0.0), (0.9, 0.0), (0.6, 0.02), (0.0, 0.02)),
    "IIc": (
        (1.0, 0.0), (0.93, 0.0), (0.9, 0.13), (0.8, 0.16), (0.66, 0.12),
        (0.6, -0.1), (0.4, -0.14), (0.0, -0.13),
    ),
}
# fmt: on
_HIGHEST = {"IIa": 2.5 * MM, "IIc": 2.0 * MM}


@dataclass(frozen=True)
class Surface:
    """Differences of a kind of polyp's surface from the surrounding mucosa.

    Attributes:
        tint: Fraction of the surrounding mucosa's reflectance: red, green, blue.
        lobes: RMS height of its lobes as a fraction of its size.
        lobe_spacing: Distance between lobes as a fraction of its size.
        wavelength: Distance between the crests of its surface pattern [m].
        relief: RMS height of that pattern [m].
        contrast: Change of brightness between crests and pits.
        roughness: Change of perceptual roughness.
    """

    tint: tuple[float, float, float]
    lobes: float
    lobe_spacing: float
    wavelength: float
    relief: float
    contrast: float
    roughness: float = 0.0


# Fitted visually to endoscopic images under white light: adenomas redder and darker than their
# surroundings, serrated and hyperplastic ones paler (NICE types 2 and 1), inflammatory ones red.
SURFACES: dict[str, Surface] = {
    "tubular": Surface((0.98, 0.78, 0.78), 0.016, 0.6, 0.45 * MM, 0.012 * MM, 0.14),
    "villous": Surface((1.04, 0.90, 0.92), 0.032, 0.36, 0.95 * MM, 0.045 * MM, 0.22, 0.05),
    "serrated": Surface((1.10, 1.22, 1.12), 0.020, 0.45, 0.55 * MM, 0.012 * MM, 0.10, 0.12),
    "hyperplastic": Surface((1.12, 1.28, 1.34), 0.008, 0.6, 0.35 * MM, 0.006 * MM, 0.08),
    "inflammatory": Surface((0.88, 0.42, 0.36), 0.026, 0.5, 0.6 * MM, 0.02 * MM, 0.12, -0.1),
}


@dataclass(frozen=True, kw_only=True)
class Polyp(SizedLesion):
    """Polyp.

    Attributes:
        shape: Paris type: pedunculated, sessile, slightly elevated, flat or slightly depressed
            (Gastrointest. Endosc. 2003, 58 S3).
        size: Maximum diameter, for Ip that of the head [m], 2 to 30 mm.
        pattern: Kind of surface, see `SURFACES`.
    """

    shape: Literal["Ip", "Is", "IIa", "IIb", "IIc"] = "Is"
    size: Annotated[float, Range(2.0 * MM, 30.0 * MM, unit="m")] = 8.0 * MM
    pattern: Literal["tubular", "villous", "serrated", "hyperplastic", "inflammatory"] = "tubular"

    kind: ClassVar[str] = "polyp"
    grade_field: ClassVar[str] = "shape"
    grade_scale: ClassVar[str] = "Paris"

    @classmethod
    def library(cls) -> dict[str, Lesion]:
        """The 20 polyps of the VR-Caps paper, by Paris type and surface."""
        sizes: dict[Any, float] = {"Ip": 14.0, "Is": 9.0, "IIa": 11.0, "IIc": 10.0}
        patterns: tuple[Any, ...] = PATTERNS
        return {
            f"polyp-{shape}-{pattern}": cls(
                shape=shape, size=(size + number) * MM, pattern=pattern, variant=number
            )
            for shape, size in sizes.items()
            for number, pattern in enumerate(patterns)
        }

    @property
    def footprint_radius(self) -> float:
        """Radius of its footprint on the wall [m]."""
        return 0.5 * self.size * _PROFILES[self.shape][0][0]

    @property
    def head_radius(self) -> float:
        """Half the size [m]."""
        return 0.5 * self.size

    @property
    def protrusion(self) -> float:
        """Height over the wall [m]."""
        return float(_control(self.shape, self.size)[:, 1].max())

    def form(self, site: LesionSite, rng: np.random.Generator) -> PolypForm:
        """Draw the irregularities."""
        return PolypForm(self, site, rng)


class PolypForm(ProfileForm):
    """Polyp with its irregularities drawn."""

    def __init__(self, polyp: Polyp, site: LesionSite, rng: np.random.Generator) -> None:
        self.polyp, surface = polyp, SURFACES[polyp.pattern]
        side = site.down - (site.down @ site.axes[:, 2]) * site.axes[:, 2]
        lean = site.axes[:, :2] @ rng.normal(0.0, 0.12, 2) + 0.3 * side
        flatness = min(1.0, polyp.protrusion / (0.3 * polyp.size))
        super().__init__(
            site,
            _control(polyp.shape, polyp.size),
            rng,
            waviness={"Ip": 0.05, "Is": 0.07}.get(polyp.shape, 0.14),
            upright=polyp.shape in ("Ip", "Is"),
            lobes=(surface.lobes * polyp.size * flatness, surface.lobe_spacing * polyp.size),
            lean=lean * float(polyp.shape == "Ip"),
            size=polyp.size,
        )
        self._pattern = band_pass(surface.wavelength, rng)
        self._mottle = fbm(max(0.3 * polyp.size, 1.5 * MM), rng)
        self._vessels = band_pass(1.6 * MM, rng)

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Paint the kind's mottled color over the mucosa without its vessels, and its pattern."""
        surface = SURFACES[self.polyp.pattern]
        color = mix(clean.color, clean.plain, np.full(len(points), 0.85)) * surface.tint
        pattern, mottle = self._pattern(points), self._mottle(points)
        crest = np.tanh(1.5 * pattern)
        color = color * np.exp(surface.contrast * (crest - 0.2))[:, None] ** (0.7, 1.25, 1.25)
        color = color * np.exp(0.12 * mottle)[:, None] ** (0.5, 1.3, 1.2)
        color, roughness = self._decorated(color, points, mottle, clean.roughness)
        height = clean.height * 0.5 + surface.relief * crest
        look = (color, roughness + surface.roughness, height)
        return self.blended(wall, clean, look, softness=0.12)

    def _decorated(self, color, points, mottle, roughness):
        """Paint fine vessels, mucus and exudate, according to the kind."""
        kind = self.polyp.pattern
        if kind in ("tubular", "villous", "inflammatory"):
            vessel = np.exp(-((self._vessels(points) / 0.10) ** 2)) * 0.35
            color = color * (1.0 - vessel[:, None] * (0.15, 0.8, 0.8))
        if kind == "serrated":
            mucus = smoothstep((mottle - 0.2) / 1.6)
            color = mix(color, np.array([0.43, 0.33, 0.15]), 0.55 * mucus)
            roughness = roughness + 0.15 * mucus
        if kind == "inflammatory":
            slough = smoothstep((mottle - 0.8) / 0.9)
            color = mix(color, FIBRIN, 0.75 * slough)
            blood = np.clip(-mottle - 1.0, 0.0, 1.0)
            color = under_blood(color, 0.25 * MM * blood)
        return color, roughness


def _control(shape: str, size: float) -> Float[np.ndarray, "k 2"]:
    """Control points of the profile [m]."""
    control = np.array(_PROFILES[shape]) * (0.5 * size)
    if shape in _HIGHEST:
        control[:, 1] *= min(1.0, _HIGHEST[shape] / np.abs(control[:, 1]).max())
    return control
