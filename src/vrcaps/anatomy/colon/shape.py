"""Colon wall shape: distance from the centerline at every arc length and angle.

The cross-section of the lumen is a star-shaped curve r(s, θ) with three taeniae. In each of the
three strips between them sacculations bulge outwards, separated by semilunar folds whose crests
are chords across the strip, so that three folds leave a triangular opening. Without gas the slack
wall closes to a star of pleats with gas pockets in between.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.colon.course import blend, lumen_radius
from vrcaps.anatomy.tube_mesh.swept_surface import Crests, Folds, dome, within_bend, wrap
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import CM, DEG, MM
from vrcaps.organ.waves import draw_waves, sum_waves

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.colon.parameters import ColonParameters
    from vrcaps.anatomy.tube_mesh.tube import Tube

_STRIP = 2.0 * np.pi / 3.0
_ANAL_RADIUS = 9 * MM
_PLEATS = 6
"""Number of pleats of the closed wall: one at each taenia and one in each strip."""
_GAP = 0.9 * MM
"""Distance of the pleat crests from the centerline where the lumen is closed."""
_SHRUNK = 0.8
"""Radius between the pleats of a closed region relative to that of a gas pocket."""
_VALVES_FROM_ANUS = (12 * CM, 9 * CM, 6.5 * CM)
"""Distances of the upper, middle and lower valve of Houston from the anus [m] (Gray's Anatomy:
11 to 13, 8 to 9, 5 to 7 cm)."""


@dataclass(frozen=True)
class ColonWall:
    """Random properties of a colon that define r(s, θ).

    Attributes:
        parameters: Dimensions of the patient.
        tube: Course with its frames.
        strips: Semilunar folds of each of the three strips.
        valves: Valves of Houston.
        taenia_angle: Angle of the first taenia at arc length 0 and its drift [rad, rad/m].
        ileocaecal: Arc length [m] and angle [rad] of the ileocaecal valve.
        diameter_waves: Slow relative variation of the diameter: (amplitude, 1/m, lobes, phase).
        relief_waves: Fine irregularity of the wall: (amplitude [m], 1/m, lobes, phase).
        closing_waves: Field that closes the lumen without gas where it is above −0.5.
        pleat_waves: Angular shift of the pleats [rad].
    """

    parameters: ColonParameters
    tube: Tube
    strips: tuple[Folds, Folds, Folds]
    valves: Folds
    taenia_angle: tuple[float, float]
    ileocaecal: tuple[float, float]
    diameter_waves: Float[np.ndarray, "n 4"]
    relief_waves: Float[np.ndarray, "n 4"]
    closing_waves: Float[np.ndarray, "n 4"]
    pleat_waves: Float[np.ndarray, "n 4"]


def draw_colon_wall(parameters: ColonParameters, tube: Tube, rng: np.random.Generator) -> ColonWall:
    """Draw a patient's folds, taeniae and irregularities.

    Args:
        parameters: Dimensions of the patient.
        tube: Course with its frames.
        rng: Random generator of folds, taeniae and irregularities.
    """
    taenia_angle = (rng.uniform(-np.pi, np.pi), rng.uniform(-1.5, 1.5))
    strips = tuple(_draw_strip(parameters, (k + 0.5) * _STRIP, k, rng) for k in range(3))
    caecum = parameters.caecum.length
    # The ileum enters from the medial, slightly posterior side: patient +x for the right flank.
    ileocaecal = (caecum, tube.angle_of(caecum, np.array([1.0, 0.4, 0.0])))
    diameter = draw_waves(rng, 14, (9 * CM, 40 * CM), 0.05, np.array([0, 0, 1, 2, 2, 3]))
    relief = draw_waves(rng, 60, (12 * MM, 60 * MM), parameters.roughness, np.arange(-9, 10))
    valves = _draw_valves(parameters, tube, taenia_angle, rng)
    closing = pleats = np.zeros((0, 4))
    if parameters.closing:
        closing = draw_waves(rng, 12, (8 * CM, 24 * CM), 1.0, np.array([0]))
        pleats = draw_waves(rng, 16, (3 * CM, 12 * CM), 0.12, np.array([0, 1, 2, 3]))
    return ColonWall(
        parameters,
        tube,
        (strips[0], strips[1], strips[2]),
        valves,
        taenia_angle,
        ileocaecal,
        diameter,
        relief,
        closing,
        pleats,
    )


def envelope_radius(
    parameters: ColonParameters, arc_length: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Radius of the plain tube [m]: segments, closed caecal dome, anal canal and its closed end."""
    full = lumen_radius(parameters, arc_length)
    from_anus = parameters.length - arc_length
    fraction = smoothstep((from_anus - 2.2 * CM) / (3.5 * CM))
    full = _ANAL_RADIUS + (full - _ANAL_RADIUS) * fraction
    for distance, depth in (
        (arc_length, 0.45 * parameters.caecum.diameter),
        (from_anus, _ANAL_RADIUS),
    ):
        full = full * dome(distance, depth)
    return full


def wall_radius(
    wall: ColonWall, arc_length: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Distance of the wall from the centerline [m].

    Args:
        wall: The colon.
        arc_length: Arc length along the centerline [m].
        theta: Angle around it [rad].
    """
    s, parameters = arc_length, wall.parameters
    envelope = envelope_radius(parameters, s)
    # All terms that depend on θ fade out where the tube closes.
    plain = lumen_radius(parameters, s)
    fade = np.clip(envelope / plain, 0.0, 1.0) ** 2
    from_taenia = theta - wall.taenia_angle[0] - wall.taenia_angle[1] * s
    radius = envelope * (1.0 + fade * sum_waves(wall.diameter_waves, s, theta))
    radius = radius * (1.0 + fade * _sacculation(wall, s, from_taenia))
    curvature = wall.tube.curvature_towards(s, theta)
    stretch = 1.0 - radius * curvature
    inner = np.clip((stretch - 0.1) / 0.5, 0.25, 1.0) * _clear_of_valve(wall, s, theta, radius)
    relief = _taenia_relief(wall, s, from_taenia, radius) * fade
    for strip in (*wall.strips, wall.valves):
        relief = relief + fade * inner * _fold_relief(strip, s, from_taenia, plain)
    relief = relief + fade * _ileocaecal_relief(wall, s, theta, radius)
    relief = relief + fade * sum_waves(wall.relief_waves, s, theta)
    radius = np.maximum(radius - relief, 0.3 * envelope)
    if parameters.closing:
        radius = _closed(wall, s, from_taenia, radius, fade)
    return within_bend(radius, curvature)


def wall_crests(wall: ColonWall, angles: Float[np.ndarray, " k"]) -> Crests:
    """Crests of all folds at given angles [rad]; their weight fades towards the ends of folds."""
    lines, weights = [], []
    for folds in (*wall.strips, wall.valves):
        s = folds.arc_length[:, None]
        from_taenia = angles - wall.taenia_angle[0] - wall.taenia_angle[1] * s
        offset = wrap(from_taenia - folds.angle[:, None])
        index = np.arange(len(s))[:, None]
        lines.append(folds.crest(index, offset, lumen_radius(wall.parameters, s)))
        fraction = 1.3 * (1.0 - np.abs(offset) / folds.extent[:, None])
        weights.append(np.clip(fraction, 0.0, 1.0) ** 0.5)
    return Crests(np.concatenate(lines), np.concatenate(weights))


def _closed(
    wall: ColonWall, s: np.ndarray, from_taenia: np.ndarray, radius: np.ndarray, fade: np.ndarray
) -> np.ndarray:
    """Radius of the slack wall: pleats that meet at the center, except in gas pockets."""
    share = smoothstep(sum_waves(wall.closing_waves, s, np.zeros_like(s)) / 0.8 + 1.1)
    around = from_taenia + sum_waves(wall.pleat_waves, s, from_taenia)
    # 0 on the crests; steep flanks make the crests broad and the clefts narrow.
    cleft = (0.5 - 0.5 * np.cos(_PLEATS * around)) ** 1.3
    closed = _GAP + np.maximum(_SHRUNK * radius - _GAP, 0.0) * cleft
    return radius + wall.parameters.closing * share * fade * (np.minimum(closed, radius) - radius)


def _sacculation(wall: ColonWall, s: np.ndarray, from_taenia: np.ndarray) -> np.ndarray:
    """Relative outward bulge of the haustra, minus the flattening to a triangle."""
    parameters = wall.parameters
    height = blend(parameters, [p.fold_height for p in parameters.segments], s)
    triangle = blend(parameters, [p.triangularity for p in parameters.segments], s)
    depth = parameters.haustra_depth * np.clip(height / (7 * MM), 0.0, 1.0)
    bulge = np.zeros_like(s)
    for strip in wall.strips:
        offset = wrap(from_taenia - strip.angle[0])
        across = np.cos(np.clip(1.15 * offset, -0.5 * np.pi, 0.5 * np.pi)) ** 2
        before = np.clip(np.searchsorted(strip.arc_length, s) - 1, 0, len(strip.height) - 2)
        start, end = strip.arc_length[before], strip.arc_length[before + 1]
        along = np.clip((s - start) / (end - start), 0.0, 1.0)
        bulge += across * (depth * (1.0 - np.cos(np.pi * along) ** 6) - triangle)
    return bulge


def _fold_relief(
    folds: Folds, s: np.ndarray, from_taenia: np.ndarray, plain: np.ndarray
) -> np.ndarray:
    """Height of the nearest folds above the wall [m]; `plain` is the radius of the lumen."""
    relief = np.zeros_like(s)
    last = len(folds.height) - 1
    after = np.searchsorted(folds.arc_length, s)
    for i in (after - 1, after):
        k = np.clip(i, 0, last)
        offset = wrap(from_taenia - folds.angle[k])
        crest = folds.crest(k, offset, plain)
        chord = np.cos(folds.extent[k]) / np.maximum(np.cos(offset), 1e-3)
        across = np.clip((1.0 - chord) / (1.0 - np.cos(folds.extent[k])), 0.0, 1.0)
        across = np.where(np.abs(offset) < folds.extent[k], across**1.2, 0.0)
        along = np.exp2(-(np.abs(2.0 * (s - crest) / folds.thickness[k]) ** 1.8))
        relief += np.where((i >= 0) & (i <= last), folds.height[k] * across * along, 0.0)
    return relief


def _taenia_relief(
    wall: ColonWall, s: np.ndarray, from_taenia: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Height of the three bands above the wall [m]; none in the rectum."""
    parameters = wall.parameters
    present = blend(parameters, [1.0] * 6 + [0.6, 0.0], s)
    distance = radius * (np.mod(from_taenia + 0.5 * _STRIP, _STRIP) - 0.5 * _STRIP)
    return (
        present
        * parameters.taenia_depth
        * np.exp2(-((2.0 * distance / parameters.taenia_width) ** 2))
    )


def _ileocaecal_relief(
    wall: ColonWall, s: np.ndarray, theta: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Height of the valve's two lips [m], closed to a slit along the circumference."""
    along = (s - wall.ileocaecal[0]) / (9 * MM)
    across = radius * wrap(theta - wall.ileocaecal[1]) / (15 * MM)
    lips = np.exp(-((along**2 + across**2) ** 1.5))
    slit = np.exp(-((along / 0.28) ** 2) - (across / 0.75) ** 4)
    return wall.parameters.ileocaecal_height * (lips - 0.45 * slit)


def _clear_of_valve(
    wall: ColonWall, s: np.ndarray, theta: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Factor that fades the folds near the ileocaecal valve, 0 at its center."""
    along = (s - wall.ileocaecal[0]) / (15 * MM)
    across = radius * wrap(theta - wall.ileocaecal[1]) / (20 * MM)
    return 1.0 - np.exp(-((along**2 + across**2) ** 2))


def _draw_strip(
    parameters: ColonParameters, angle: float, index: int, rng: np.random.Generator
) -> Folds:
    """Draw the semilunar folds of one strip, from above the caecal pole to the rectum."""
    end = parameters.length - parameters.rectum.length
    spread = parameters.fold_irregularity
    spacings = [segment.haustra_spacing for segment in parameters.segments]
    heights = [segment.fold_height for segment in parameters.segments]
    positions = [3 * CM + index / 3.0 * spacings[0]]
    while True:
        spacing = float(blend(parameters, spacings, np.array(positions[-1])))
        step = spacing * np.clip(1.0 + spread * rng.standard_normal(), 0.6, 1.6)
        if positions[-1] + step > end:
            break
        positions.append(positions[-1] + step)
    s = np.array(positions)
    height = blend(parameters, heights, s) * np.exp(spread * rng.standard_normal(len(s)))
    return Folds(
        arc_length=s,
        angle=np.full(len(s), angle),
        height=np.clip(height, 3 * MM, 10 * MM),
        extent=rng.uniform(60 * DEG, 74 * DEG, len(s)),
        thickness=parameters.fold_thickness * rng.uniform(0.8, 1.25, len(s)),
        tilt=0.12 * rng.standard_normal(len(s)),
        bow=0.12 * rng.standard_normal(len(s)),
    )


def _draw_valves(
    parameters: ColonParameters,
    tube: Tube,
    taenia_angle: tuple[float, float],
    rng: np.random.Generator,
) -> Folds:
    """Draw the three valves of Houston, on the left, the right and the left wall."""
    s = parameters.length - np.array(_VALVES_FROM_ANUS) * (parameters.rectum.length / (17.7 * CM))
    left = np.array([1.0, 0.0, 0.0])
    sides = [
        tube.angle_of(position, sign * left) for position, sign in zip(s, (1, -1, 1), strict=True)
    ]
    return Folds(
        arc_length=s,
        angle=np.array(sides) - taenia_angle[0] - taenia_angle[1] * s + rng.normal(0.0, 0.2, 3),
        height=parameters.valve_height * np.array([0.85, 1.0, 0.8]),
        extent=np.full(3, 80 * DEG),
        thickness=np.full(3, 1.5 * parameters.fold_thickness),
        tilt=0.1 * rng.standard_normal(3),
        bow=0.1 * rng.standard_normal(3),
    )
