"""Polyps: real shapes of the Paris classification, five kinds of surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from scipy.interpolate import BSpline

from vrcaps.organ.lesion.base import (
    Lesion,
    Look,
    Site,
    WallSamples,
    mix,
    require_range,
    smoothstep,
)
from vrcaps.organ.lesion.noise import around, cloud, grain
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

SHAPES = ("Ip", "Is", "IIa", "IIb", "IIc")
"""Paris classification of superficial neoplastic lesions (Gastrointest. Endosc. 2003, 58 S3):
pedunculated, sessile, slightly elevated, flat, slightly depressed."""

PATTERNS = ("tubular", "villous", "serrated", "hyperplastic", "inflammatory")
"""Kinds of surface, after the histology they go with."""

# Profiles from the rim of the footprint to the top, as control points of a cubic B-spline: way
# from the axis and height, in radii of the head. Height over width as the Paris workshop draws
# them: Is stands higher than a closed forceps (2.5 mm), IIa lower, IIc sinks into the wall.
_PROFILES = {
    "Ip": (
        *((0.62, 0.0), (0.46, 0.0), (0.36, 0.06), (0.32, 0.35), (0.31, 0.8), (0.33, 1.15)),
        *((0.55, 1.12), (1.0, 1.12), (1.16, 1.75), (0.95, 2.45), (0.42, 2.62), (0.0, 2.62)),
    ),
    "Is": (
        *((1.05, 0.0), (0.93, 0.0), (0.88, 0.05), (0.9, 0.3), (1.1, 0.75)),
        *((0.92, 1.3), (0.42, 1.42), (0.0, 1.42)),
    ),
    "IIa": ((1.0, 0.0), (0.96, 0.0), (0.93, 0.02), (0.93, 0.26), (0.75, 0.32), (0.0, 0.34)),
    "IIb": ((1.0, 0.0), (0.9, 0.0), (0.6, 0.02), (0.0, 0.02)),
    "IIc": (
        *((1.0, 0.0), (0.93, 0.0), (0.9, 0.13), (0.8, 0.16), (0.66, 0.12)),
        *((0.6, -0.1), (0.4, -0.14), (0.0, -0.13)),
    ),
}
_HIGHEST = {"IIa": 2.5 * MM, "IIc": 2.0 * MM}


@dataclass(frozen=True)
class Surface:
    """How a kind of polyp's surface differs from the mucosa around it.

    Attributes:
        tint: Share of the surrounding mucosa's reflectance: red, green, blue.
        lobes: Height of its lobes as a share of its size.
        wavelength: Distance between the crests of its surface pattern [m].
        relief: RMS height of that pattern [m].
        contrast: Change of brightness between crests and pits.
        roughness: Change of perceptual roughness.
    """

    tint: tuple[float, float, float]
    lobes: float
    wavelength: float
    relief: float
    contrast: float
    roughness: float = 0.0


# Fitted by eye to endoscopic images under white light: adenomas redder and darker than their
# surroundings, serrated and hyperplastic ones paler (NICE types 2 and 1), inflammatory ones red.
SURFACES: dict[str, Surface] = {
    "tubular": Surface((0.98, 0.78, 0.78), 0.05, 0.45 * MM, 0.02 * MM, 0.16),
    "villous": Surface((1.04, 0.92, 0.95), 0.11, 0.95 * MM, 0.07 * MM, 0.24, 0.05),
    "serrated": Surface((1.14, 1.32, 1.18), 0.06, 0.55 * MM, 0.02 * MM, 0.12, 0.12),
    "hyperplastic": Surface((1.18, 1.42, 1.48), 0.02, 0.35 * MM, 0.008 * MM, 0.10),
    "inflammatory": Surface((0.92, 0.42, 0.36), 0.07, 0.6 * MM, 0.03 * MM, 0.12, -0.1),
}


@dataclass(frozen=True, kw_only=True)
class Polyp(Lesion):
    """A polyp.

    Attributes:
        shape: Paris type.
        size: Largest diameter [m], 2 to 30 mm.
        pattern: Kind of surface, see `SURFACES`.
    """

    shape: Literal["Ip", "Is", "IIa", "IIb", "IIc"] = "Is"
    size: float = 8.0 * MM
    pattern: Literal["tubular", "villous", "serrated", "hyperplastic", "inflammatory"] = "tubular"

    kind: ClassVar[str] = "polyp"

    def __post_init__(self) -> None:
        require_range("Size of a polyp", self.size, 2.0 * MM, 30.0 * MM)

    @property
    def grade(self) -> str:
        """Paris type."""
        return self.shape

    @property
    def footprint_radius(self) -> float:
        """Radius of the wall it takes [m]."""
        return 0.5 * self.size * _PROFILES[self.shape][0][0]

    @property
    def reach_in(self) -> float:
        """Height over the wall [m]."""
        return float(_profile(self.shape, self.size)[1].max())

    def form(self, site: Site, rng: np.random.Generator) -> PolypForm:
        """Draw its irregularities."""
        return PolypForm(self, site, rng)


class PolypForm:
    """A polyp with its irregularities drawn."""

    def __init__(self, polyp: Polyp, site: Site, rng: np.random.Generator) -> None:
        self.polyp, self.site = polyp, site
        surface = SURFACES[polyp.pattern]
        self.edge_length = float(np.clip(polyp.size / 22.0, 0.12 * MM, 0.7 * MM))
        self.border_length = 0.025 * polyp.footprint_radius
        self._r, self._z, way = _profile(polyp.shape, polyp.size)
        self._share = way / way[-1]  # 1 at the rim, 0 at the top
        self._length = float(way[-1])
        self._outline = around(4, rng)
        self._waviness = {"Ip": 0.05, "Is": 0.07}.get(polyp.shape, 0.14)
        self._lobes = cloud(0.42 * polyp.size, rng)
        self._lobe_height = surface.lobes * polyp.size * min(1.0, self._z.max() / (0.3 * polyp.size))
        self._pattern = grain(surface.wavelength, rng)
        self._mottle = cloud(max(0.3 * polyp.size, 1.5 * MM), rng)
        self._vessels = grain(1.6 * MM, rng)
        side = site.down - (site.down @ site.axes[:, 2]) * site.axes[:, 2]
        lean = rng.normal(0.0, 0.12, 2)
        self._lean = (site.axes[:, :2] @ lean + 0.3 * side) * float(polyp.shape == "Ip")

    def _polar(self, wall: WallSamples):
        """Way from the centre [m], unit direction in the chart, radius of the outline there."""
        rho = np.linalg.norm(wall.xy, axis=1)
        angle = np.arctan2(wall.xy[:, 1], wall.xy[:, 0])
        stretch = 1.0 + self._waviness * self._outline(angle)
        return rho, np.stack([np.cos(angle), np.sin(angle)], axis=1), stretch

    def depth(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Distance within the outline [m]."""
        rho, _, stretch = self._polar(wall)
        return stretch * self.polyp.footprint_radius - rho

    def moved(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions on the polyp [m]: its profile turned around the axis, with lobes."""
        rho, direction, stretch = self._polar(wall)
        share = rho / (stretch * self.polyp.footprint_radius)
        share = np.minimum(share, 1.0)
        r = np.interp(share, self._share, self._r) * stretch
        z = np.interp(share, self._share, self._z)
        outward = direction @ self.site.axes[:, :2].T
        upright = smoothstep((1.0 - share) / 0.3) * (self.polyp.shape in ("Ip", "Is"))
        plane = self.site.center + rho[:, None] * outward
        base = mix(wall.rest, plane, upright)
        axis = mix(wall.normal, np.broadcast_to(self.site.axes[:, 2], wall.normal.shape), upright)
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        bend = (z / max(self._z.max(), 1e-9)) ** 2 * self._z.max()
        points = base + (r - rho)[:, None] * outward + z[:, None] * axis
        points += bend[:, None] * self._lean
        slope_r = np.interp(share, self._share, np.gradient(self._r, self._share))
        slope_z = np.interp(share, self._share, np.gradient(self._z, self._share))
        norm = np.maximum(np.hypot(slope_r, slope_z), 1e-12)
        facing = (-slope_z / norm)[:, None] * outward + (slope_r / norm)[:, None] * axis
        lobes = self._lobes(points - self.site.center) * self._lobe_height
        lobes = lobes * smoothstep((1.0 - share) / 0.35)
        points = points + lobes[:, None] * facing
        return np.where((share < 1.0)[:, None], points, wall.rest)

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """The surface flattened with true lengths away from the top [m]."""
        rho, direction, stretch = self._polar(wall)
        rim = stretch * self.polyp.footprint_radius
        way = np.where(rho < rim, rho / rim * self._length, self._length + (rho - rim))
        return way[:, None] * direction

    def painted(self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: Look) -> Look:
        """The kind's colour, mottled, over the mucosa without its vessels; its pattern."""
        surface = SURFACES[self.polyp.pattern]
        inside = smoothstep(self.depth(wall) / (0.06 * self.polyp.size))
        color = mix(clean.color, clean.plain, np.full(len(inside), 0.85)) * surface.tint
        pattern, mottle = self._pattern(points), self._mottle(points)
        crest = np.tanh(1.5 * pattern)
        color = color * np.exp(surface.contrast * (crest - 0.2))[:, None] ** (0.7, 1.25, 1.25)
        color = color * np.exp(0.12 * mottle)[:, None] ** (0.5, 1.3, 1.2)
        color, roughness = self._decorated(color, points, mottle, clean.roughness)
        height = clean.height * 0.5 + surface.relief * crest
        return replace(
            clean,
            color=np.clip(mix(clean.color, color, inside), 0.0, 1.0),
            roughness=clean.roughness + (roughness + surface.roughness - clean.roughness) * inside,
            height=clean.height + (height - clean.height) * inside,
        )

    def _decorated(self, color, points, mottle, roughness):
        """Fine vessels, mucus and exudate, as the kind has them."""
        kind = self.polyp.pattern
        if kind in ("tubular", "villous", "inflammatory"):
            vessel = np.exp(-((self._vessels(points) / 0.10) ** 2)) * 0.35
            color = color * (1.0 - vessel[:, None] * (0.15, 0.8, 0.8))
        if kind == "serrated":
            mucus = smoothstep((mottle - 0.5) / 0.8)
            color = mix(color, np.array([0.62, 0.42, 0.14]), 0.65 * mucus)
            roughness = roughness + 0.15 * mucus
        if kind == "inflammatory":
            slough = smoothstep((mottle - 0.9) / 0.3)
            color = mix(color, np.array([0.72, 0.56, 0.34]), 0.85 * slough)
            blood = smoothstep((-mottle - 1.1) / 0.25)
            color = mix(color, np.array([0.24, 0.012, 0.01]), 0.9 * blood)
        return color, roughness


def _profile(
    shape: str, size: float
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Way from the axis, height, and way along the profile from the top [m], top first."""
    control = np.array(_PROFILES[shape])[::-1] * (0.5 * size)
    if shape in _HIGHEST:
        control[:, 1] *= min(1.0, _HIGHEST[shape] / np.abs(control[:, 1]).max())
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, len(control) - 2), [1.0] * 3])
    r, z = BSpline(knots, control, 3)(np.linspace(0.0, 1.0, 400)).T
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))])
    return r, z, way
