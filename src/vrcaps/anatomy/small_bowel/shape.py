"""Small bowel wall shape: distance from the course at every arc length and angle.

Circular folds, each over part of the circumference, stand on a tube that narrows towards the
ileocaecal valve. At contractions the slack wall closes to a star. A wall without gas or fluid
buckles into rounded, irregular folds in contact with each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.small_bowel.parameters import BULB_LENGTH
from vrcaps.anatomy.tube_mesh.swept_surface import Folds, within_bend, wrap
from vrcaps.core.geometry import fold_profile, smoothstep
from vrcaps.core.units import CM, MM
from vrcaps.organ.waves import draw_waves, sum_waves

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float

    from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
    from vrcaps.anatomy.tube_mesh.tube import Tube

PYLORUS_RADIUS = 6.6 * MM
_PAPILLA = 9 * CM
"""Arc length of the major papilla, on the inner wall of the second part of the duodenum [m]."""
_CALIBRE_SPREAD = 0.035


@dataclass(frozen=True)
class Contractions:
    """Contractions, sorted by arc length.

    Attributes:
        arc_length: Center of each contraction [m].
        depth: Fraction of the radius taken by each.
        width: Extent along the gut [m].
        lobes: Number of longitudinal folds of its wall.
        phase: Phase of those folds [rad].
    """

    arc_length: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]
    width: Float[np.ndarray, " n"]
    lobes: Float[np.ndarray, " n"]
    phase: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class SlackFolds:
    """Rounded folds of a slack wall: the zeros of the sum of two random fields are the creases.

    Attributes:
        across: Field with zeros mostly around the gut.
        along: Field with zeros mostly along the gut.
        warp: Displacement of the creases along the gut [m].
        height: Relative height by place.
        tone: Relative height by arc length: smooth stretches alternate with puckered ones.
    """

    across: Float[np.ndarray, "n 4"]
    along: Float[np.ndarray, "n 4"]
    warp: Float[np.ndarray, "n 4"]
    height: Float[np.ndarray, "n 4"]
    tone: Float[np.ndarray, "n 4"]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> SlackFolds:
        """Draw the folds of a patient."""
        few, some, every = np.arange(-2, 3), np.arange(-3, 4), np.array([-6, -5, -4, 4, 5, 6])
        return cls(
            draw_waves(rng, 56, (6 * MM, 11 * MM), 1.0, np.append(some, [0, 0, 0])),
            draw_waves(rng, 28, (15 * MM, 60 * MM), 1.0, every),
            draw_waves(rng, 28, (6 * MM, 30 * MM), 1.3 * MM, some),
            draw_waves(rng, 24, (10 * MM, 40 * MM), 0.35, few),
            draw_waves(rng, 24, (30 * MM, 160 * MM), 1.0, np.array([0])),
        )

    def relief(
        self, s: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Height at places, 0 in the deepest creases and about 1 on the folds."""
        around = sum_waves(self.across, s + sum_waves(self.warp, s, theta), theta)
        pleats = sum_waves(self.along, s, theta)
        tone = sum_waves(self.tone, s, np.zeros(1))
        vary = sum_waves(self.height, s, theta)
        height = np.clip(0.5 + 0.5 * tone, 0.05, 1.3) * np.clip(1.0 + vary, 0.3, 1.6)
        turn = 0.25 * np.pi * (1.0 + 0.6 * np.sin(3.0 * tone))
        return height * fold_profile(np.cos(turn) * around + np.sin(turn) * pleats)


@dataclass(frozen=True)
class SmallBowelWall:
    """Random properties of a small bowel that define r(s, θ).

    Attributes:
        parameters: Dimensions of the patient.
        envelope: Radius of the plain tube [m] at arc lengths [m].
        folds: Circular folds.
        contractions: Contractions of the lumen.
        papilla_angle: Angle of the major papilla [rad].
        diameter_waves: Slow relative variation of the diameter.
        star_waves: Slow variation of the longitudinal folds' phase [rad].
        crest_waves: Relative variation of the fold height along and around the gut.
        relief_waves: Fine irregularity of the wall [m].
        slack: Folds of the slack wall.
    """

    parameters: SmallBowelParameters
    envelope: Callable[[np.ndarray], np.ndarray]
    folds: Folds
    contractions: Contractions
    papilla_angle: float
    diameter_waves: Float[np.ndarray, "n 4"]
    star_waves: Float[np.ndarray, "n 4"]
    crest_waves: Float[np.ndarray, "n 4"]
    relief_waves: Float[np.ndarray, "n 4"]
    slack: SlackFolds


def draw_small_bowel_wall(
    parameters: SmallBowelParameters, rng: np.random.Generator
) -> SmallBowelWall:
    """Draw a patient's folds, contractions and irregularities."""
    few, many = np.array([0, 0, 0, 1, 1, 2]), np.arange(-6, 7)
    return SmallBowelWall(
        parameters,
        small_bowel_envelope(parameters),
        _draw_folds(parameters, rng),
        _draw_contractions(parameters, rng),
        float(rng.uniform(-np.pi, np.pi)),
        draw_waves(rng, 20, (4 * CM, 16 * CM), _CALIBRE_SPREAD, few),
        draw_waves(rng, 10, (5 * CM, 15 * CM), 1.2, np.array([0])),
        draw_waves(rng, 24, (9 * MM, 40 * MM), 0.16, many),
        draw_waves(rng, 48, (8 * MM, 40 * MM), parameters.roughness, many),
        SlackFolds.draw(*rng.spawn(1)),
    )


def outer_radius(wall: SmallBowelWall, num: int) -> Float[np.ndarray, " n"]:
    """Distance of the outer wall from the course [m], at even fractions of the length."""
    s = np.linspace(0.0, wall.parameters.length, num)
    bulge = np.abs(wall.diameter_waves[:, 0]).sum()
    return wall.envelope(s) * (1.0 + min(bulge, 3.0 * _CALIBRE_SPREAD))


def small_bowel_envelope(
    parameters: SmallBowelParameters,
) -> Callable[[np.ndarray], np.ndarray]:
    """Radius of the plain tube [m]: pyloric ring, bulb, duodenum, jejunum, ileum."""
    p = parameters
    jejunum_end = p.duodenum_length + p.jejunum_fraction * (p.length - p.duodenum_length)
    ileum = p.length - jejunum_end
    s = [0.0, 3 * MM, 18 * MM, BULB_LENGTH - 8 * MM, BULB_LENGTH + 12 * MM]
    diameters = [2.0 * PYLORUS_RADIUS] * 2 + [1.12 * p.duodenum_diameter] * 2
    diameters += [p.duodenum_diameter, p.duodenum_diameter]
    s += [p.duodenum_length - 3 * CM, p.duodenum_length + 5 * CM]
    diameters += [p.jejunum_diameter, p.jejunum_diameter]
    s += [jejunum_end - 10 * CM, jejunum_end + 0.2 * ileum, jejunum_end + 0.5 * ileum]
    diameters += [p.proximal_ileum_diameter, p.distal_ileum_diameter]
    s += [p.length - 25 * CM, p.length - 10 * CM, p.length]
    diameters += [p.distal_ileum_diameter] + [p.terminal_ileum_diameter] * 2
    plain = scipy.interpolate.PchipInterpolator(s, 0.5 * np.array(diameters))
    return lambda arc_length: plain(np.clip(arc_length, 0.0, p.length))


def small_bowel_radius(
    wall: SmallBowelWall,
    tube: Tube,
    arc_length: Float[np.ndarray, " n"],
    theta: Float[np.ndarray, " n"],
    start: float = 0.0,
) -> Float[np.ndarray, " n"]:
    """Distance of the wall from the course [m].

    Args:
        wall: The small bowel.
        tube: Its course.
        arc_length: Arc length from the pylorus [m].
        theta: Angle in the tube's frames [rad].
        start: Arc length of the pylorus on the tube [m].
    """
    s, p = arc_length, wall.parameters
    plain = wall.envelope(s)
    fade = smoothstep(s / (2 * CM)) * smoothstep((p.length - s) / (2 * CM))
    radius = plain * (1.0 + fade * sum_waves(wall.diameter_waves, s, theta))
    squeeze, petals = _squeeze(wall, s, theta)
    radius = radius * (1.0 - fade * squeeze)
    curvature = tube.curvature_towards(s + start, theta)
    inner = np.clip((1.0 - radius * curvature - 0.1) / 0.5, 0.3, 1.0)
    relief = inner * _fold_relief(wall, s, theta, plain) * (1.0 - 0.5 * squeeze)
    relief = relief + radius * petals + sum_waves(wall.relief_waves, s, theta)
    if p.slack_fold_height > 0.0:
        relief = relief + inner * p.slack_fold_height * wall.slack.relief(s, theta)
    relief = fade * relief + _papilla(wall, s, theta, radius)
    least = np.minimum(p.min_radius, 0.6 * plain)
    lumen = radius - relief - least
    # Smooth maximum, so that folds that meet at the center do not intersect.
    radius = least + 0.5 * (lumen + np.sqrt(lumen**2 + (1.5 * MM) ** 2))
    # The curvature is an average; the actual bends are locally slightly sharper.
    return within_bend(radius, 1.12 * curvature)


def _squeeze(
    wall: SmallBowelWall, s: np.ndarray, theta: np.ndarray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Fraction of the radius taken by contractions, and height of longitudinal folds above it."""
    c = wall.contractions
    after = np.searchsorted(c.arc_length, s)
    squeeze, petals = np.zeros_like(s), np.zeros_like(s)
    slack = wall.parameters.longitudinal_fold_depth
    swing = sum_waves(wall.star_waves, s, np.zeros(1))
    for i in (after - 1, after):
        k = np.clip(i, 0, len(c.arc_length) - 1)
        near = np.exp(-(((s - c.arc_length[k]) / c.width[k]) ** 2))
        near = np.where((i >= 0) & (i < len(c.arc_length)), near, 0.0)
        squeeze = np.maximum(squeeze, c.depth[k] * near)
        cords = 0.5 + 0.5 * np.cos(c.lobes[k] * theta + c.phase[k] + 0.6 * swing)
        petals += 0.42 * near * cords**1.5
    # Five cords of unequal width and height: the star of a real gut is irregular.
    uneven = theta + 0.25 * np.sin(theta + 0.7 * swing)
    lobes = 0.5 + 0.5 * np.cos(5.0 * uneven + swing)
    height = 1.0 + 0.25 * np.cos(2.0 * theta - 1.3 * swing)
    return squeeze, petals + slack * height * lobes**1.5


def _fold_relief(
    wall: SmallBowelWall, s: np.ndarray, theta: np.ndarray, plain: np.ndarray
) -> np.ndarray:
    """Height of the circular folds above the wall [m]: rounded maximum of the nearby folds."""
    folds = wall.folds
    last = len(folds.height) - 1
    after = np.searchsorted(folds.arc_length, s)
    total = np.zeros_like(s)
    for i in range(-2, 2):
        k = np.clip(after + i, 0, last)
        offset = wrap(theta - folds.angle[k])
        crest = folds.crest(k, offset, plain)
        end = np.clip((folds.extent[k] - np.abs(offset)) / 0.7, 0.0, 1.0)
        along = np.exp2(-(np.abs(2.0 * (s - crest) / folds.thickness[k]) ** 2.2))
        total += (folds.height[k] * smoothstep(end) * along) ** 4
    waves = np.clip(1.0 + sum_waves(wall.crest_waves, s, theta), 0.4, 1.5)
    return waves * total**0.25


def _papilla(
    wall: SmallBowelWall, s: np.ndarray, theta: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Height of the major papilla above the wall [m], with the dimple of its orifice."""
    along = s - _PAPILLA
    across = radius * wrap(theta - wall.papilla_angle)
    hill = np.exp(-((along / (5.5 * MM)) ** 2) - (across / (3.8 * MM)) ** 2)
    pore = np.exp(-(((along + 1.5 * MM) ** 2 + across**2) / (1.1 * MM) ** 2))
    return 4.2 * MM * hill - 1.8 * MM * pore


def _draw_folds(parameters: SmallBowelParameters, rng: np.random.Generator) -> Folds:
    """Draw circular folds from the second part of the duodenum to the ileocaecal valve."""
    p = parameters
    jejunum_end = p.duodenum_length + p.jejunum_fraction * (p.length - p.duodenum_length)
    knots = [BULB_LENGTH, jejunum_end - 20 * CM, jejunum_end + 60 * CM, p.length]
    middle_folds = p.terminal_folds + 0.35 * (p.jejunum_folds - p.terminal_folds)
    middle_height = p.terminal_fold_height + 0.3 * (p.jejunum_fold_height - p.terminal_fold_height)
    density = [p.jejunum_folds, p.jejunum_folds, middle_folds, p.terminal_folds]
    heights = [p.jejunum_fold_height, p.jejunum_fold_height, middle_height, p.terminal_fold_height]
    position, s = BULB_LENGTH + 6 * MM, []
    while position < p.length - 15 * MM:
        s.append(position)
        spacing = 1.0 / float(np.interp(position, knots, density))
        position += spacing * float(np.clip(1.0 + 0.2 * rng.standard_normal(), 0.7, 1.5))
    s = np.array(s)
    num = len(s)
    height = np.interp(s, knots, heights) * np.clip(1.0 + 0.22 * rng.standard_normal(num), 0.4, 1.5)
    ramp = smoothstep((s - BULB_LENGTH) / (4 * CM))
    return Folds(
        arc_length=s,
        angle=rng.uniform(-np.pi, np.pi, num),
        height=height * (0.35 + 0.65 * ramp),
        extent=rng.uniform(1.7, 4.2, num),
        thickness=(p.fold_thickness - 0.3 * MM * s / p.length) * rng.uniform(0.9, 1.2, num),
        tilt=0.10 * np.clip(rng.standard_normal(num), -2.0, 2.0),
        bow=0.07 * np.clip(rng.standard_normal(num), -2.0, 2.0),
    )


def _draw_contractions(parameters: SmallBowelParameters, rng: np.random.Generator) -> Contractions:
    """Draw contractions at irregular distances beyond the bulb."""
    p = parameters
    num = int(p.length / p.contraction_spacing * 3.0) + 4
    s = BULB_LENGTH + np.cumsum(p.contraction_spacing * rng.uniform(0.4, 1.6, num))
    num = int(np.searchsorted(s, p.length - 6 * CM))
    return Contractions(
        arc_length=s[:num],
        depth=p.contraction_depth * rng.uniform(0.55, 1.0, num),
        width=rng.uniform(8 * MM, 18 * MM, num),
        lobes=rng.choice([4.0, 5.0, 6.0], num),
        phase=rng.uniform(0.0, 2.0 * np.pi, num),
    )
