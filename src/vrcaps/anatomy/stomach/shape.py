"""Stomach wall shape: distance from the axis at every arc length and angle.

The axis runs from the top of the fundus to slightly beyond the pyloric ring. The section is an
ellipse, wide along the curvatures and flat anteroposteriorly, with rugae on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.tube_mesh.swept_surface import within_bend, wrap
from vrcaps.anatomy.tube_mesh.tube import Course
from vrcaps.core.geometry import smoothstep
from vrcaps.core.rng import stream
from vrcaps.core.units import CM, MM
from vrcaps.organ.waves import draw_waves, sum_waves

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float

    from vrcaps.anatomy.stomach.parameters import StomachParameters
    from vrcaps.anatomy.tube_mesh.tube import Tube

_AXIS_CM = np.array(
    [
        [5.8, 4.2, 22.6],
        [5.9, 3.4, 19.3],
        [5.6, 1.8, 16.0],
        [4.8, -0.2, 12.9],
        [3.2, -1.8, 10.6],
        [0.9, -2.2, 9.7],
        [-1.3, -1.4, 10.5],
        [-2.7, 0.0, 12.0],
        [-3.6, 1.4, 13.2],
    ]
)
"""Axis of a mean stomach from fundus to duodenal bulb, patient frame, origin at the center of the
abdomen at the height of the navel; the pylorus is to the right of the midline."""

STUB = 16 * MM
"""Distance beyond the pyloric ring, in the duodenal bulb, at which the stomach ends [m]."""

_DOME = 0.62
"""Depth of the dome of the fundus in radii of the fundus."""
_INCISURA, _WAVES = 0.655, (0.76, 0.875)
"""Positions along the axis as fractions of its length."""
_CANAL = 7 * MM


@dataclass(frozen=True)
class StomachWall:
    """Random properties of a stomach that define r(s, θ).

    Attributes:
        parameters: Dimensions of the patient.
        tube: Axis with its frames.
        envelope: Radius of the plain tube [m] at arc lengths [m].
        greater: Angle of the greater curvature [rad] at arc lengths [m].
        winding: Waves that swing the phase of the rugae [rad].
        branching: Waves that make rugae end, fork and join, standard deviation 1.
        diameter_waves: Slow relative variation of the diameter.
        relief_waves: Fine irregularity of the wall [m].
    """

    parameters: StomachParameters
    tube: Tube
    envelope: Callable[[np.ndarray], np.ndarray]
    greater: Callable[[np.ndarray], np.ndarray]
    winding: Float[np.ndarray, "n 4"]
    branching: Float[np.ndarray, "n 4"]
    diameter_waves: Float[np.ndarray, "n 4"]
    relief_waves: Float[np.ndarray, "n 4"]


def stomach_course(parameters: StomachParameters, rng: np.random.Generator) -> Course:
    """Axis from the top of the fundus to the pyloric ring and the stub beyond it."""
    points = _AXIS_CM * CM + rng.normal(0.0, 3 * MM, _AXIS_CM.shape)
    fine = scipy.interpolate.CubicSpline(np.arange(len(points)), points)(
        np.linspace(0.0, len(points) - 1, 2000)
    )
    fine = _resample(
        scipy.ndimage.gaussian_filter1d(_resample(fine, 600), 45, axis=0, mode="nearest"), 600
    )
    length = parameters.length + STUB
    # The stomach hangs from the diaphragm: the top of the fundus is kept in position.
    fine = fine[0] + (fine - fine[0]) * (
        length / np.linalg.norm(np.diff(fine, axis=0), axis=1).sum()
    )
    arc_length = np.linspace(0.0, length, round(length / MM) + 1)
    return Course(_resample(fine, len(arc_length)), arc_length)


def _resample(points: Float[np.ndarray, "n 3"], num: int) -> Float[np.ndarray, "m 3"]:
    """Evenly spaced points along a polyline."""
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    even = np.linspace(0.0, chord[-1], num)
    return np.stack([np.interp(even, chord, points[:, k]) for k in range(3)], axis=1)


def stomach_wall_rng(seed: int) -> np.random.Generator:
    """Random generator of the wall of a seed's stomach, alone or in the full tract."""
    return stream(seed, "stomach/wall")


def stomach_course_rng(seed: int) -> np.random.Generator:
    """Random generator of the axis of a seed's stomach, alone or in the full tract."""
    return stream(seed, "stomach/course")


def draw_stomach_wall(
    parameters: StomachParameters, tube: Tube, rng: np.random.Generator
) -> StomachWall:
    """Draw a patient's rugae and irregularities.

    Args:
        parameters: Dimensions of the patient.
        tube: Axis with its frames.
        rng: Random generator of rugae and irregularities.
    """
    lobes = np.array([-4, -3, -2, -1, 0, 1, 2, 3, 4])
    return StomachWall(
        parameters,
        tube,
        stomach_envelope(parameters),
        _greater_curvature(parameters, tube),
        draw_waves(rng, 24, (22 * MM, 75 * MM), np.pi * parameters.rugae_winding, lobes),
        draw_waves(rng, 40, (18 * MM, 60 * MM), 1.0, np.arange(-9, 10)),
        draw_waves(rng, 12, (6 * CM, 20 * CM), 0.03, np.array([0, 1, 1, 2, 2, 3])),
        draw_waves(rng, 60, (12 * MM, 60 * MM), parameters.roughness, np.arange(-12, 13)),
    )


def stomach_envelope(parameters: StomachParameters) -> Callable[[np.ndarray], np.ndarray]:
    """Radius of the plain tube: fundus, body, antrum, pyloric ring, start of the bulb."""
    p = parameters
    ring = 0.5 * p.pylorus_diameter
    fraction = np.array([0.0, 0.12, 0.25, 0.42, 0.58, 0.66, 0.74, 0.84, 0.925])
    fundus, body, antrum = (
        0.5 * d for d in (p.fundus_diameter, p.body_diameter, p.antrum_diameter)
    )
    waist = 0.5 * (body + antrum) * 0.94
    radius = [0.96 * fundus, fundus, 0.5 * (fundus + body), body, 0.94 * body]
    radius += [waist, 1.04 * antrum, 0.95 * antrum, 0.64 * antrum]
    s = np.concatenate(
        [fraction * p.length, [p.length - 0.5 * _CANAL, p.length + 0.5 * _CANAL, p.length + STUB]]
    )
    plain = scipy.interpolate.PchipInterpolator(s, [*radius, 1.02 * ring, 1.02 * ring, 1.9 * ring])
    depth = _DOME * fundus

    def envelope(arc_length: np.ndarray) -> np.ndarray:
        beyond = np.clip(1.0 - arc_length / depth, 0.0, 1.0)
        return plain(np.clip(arc_length, 0.0, s[-1])) * np.sqrt(1.0 - beyond**2)

    return envelope


def stomach_radius(
    wall: StomachWall, arc_length: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Distance of the wall from the axis [m].

    Args:
        wall: The stomach.
        arc_length: Arc length along the axis [m].
        theta: Angle around it [rad].
    """
    s, p = arc_length, wall.parameters
    envelope = wall.envelope(s)
    # All terms that depend on θ fade out at the top and beyond the pyloric ring.
    fade = np.clip(envelope / (0.42 * p.fundus_diameter), 0.0, 1.0) ** 2
    fade = np.where(s > 0.5 * p.length, smoothstep((p.length - s) / (2 * CM)), fade)
    around = wrap(theta - wall.greater(s))
    radius = envelope * (1.0 + fade * sum_waves(wall.diameter_waves, s, theta))
    flat = p.flattening * fade * smoothstep((p.length - s) / (5 * CM))
    # Polar form of an ellipse with unchanged mean radius.
    radius = (
        radius
        * (1.0 - flat) ** 0.5
        / np.sqrt(((1.0 - flat) * np.cos(around)) ** 2 + np.sin(around) ** 2)
    )
    radius = radius * (1.0 - _antral_waves(p, s))
    relief = fade * _rugae(wall, s, around)
    relief = relief + fade * sum_waves(wall.relief_waves, s, theta)
    relief = relief + _notch(p, s, around) + fade * _cardia(wall, s, around)
    relief = relief + _pyloric_star(wall, s, around)
    radius = np.maximum(radius - relief, 0.45 * envelope)
    return within_bend(radius, wall.tube.curvature_towards(s, theta))


def cardia_position(wall: StomachWall) -> tuple[float, float]:
    """Arc length [m] and angle [rad] of the cardia, on the lesser curvature."""
    s = wall.parameters.cardia_distance
    return s, float(wrap(wall.greater(np.array([s]))[0] + np.pi))


def curvatures(wall: StomachWall) -> tuple[float, float]:
    """Lengths of the greater and the lesser curvature on the wall without folds [m].

    The greater curvature starts at the cardiac notch and runs over the fundus, the lesser at the
    lower edge of the cardia; both end at the pyloric ring.
    """
    p, half_cardia = wall.parameters, 8 * MM
    upper = np.linspace(p.cardia_distance - half_cardia, 0.0, 200)
    lower = np.linspace(p.cardia_distance + half_cardia, p.length, 400)
    down = np.linspace(0.0, p.length, 600)
    over = np.concatenate([_outline(wall, upper, np.pi), _outline(wall, down, 0.0)])
    return _polyline_length(over), _polyline_length(_outline(wall, lower, np.pi))


def stomach_volume(wall: StomachWall) -> float:
    """Volume of the lumen down to the pyloric ring [m³].

    Around a bent axis, ∫∫ (r²/2 − κ r³/3) dθ ds with κ the curvature towards θ.
    """
    s = np.linspace(0.0, wall.parameters.length, 400)
    theta = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    samples = np.repeat(s, len(theta)), np.tile(theta, len(s))
    radius = stomach_radius(wall, *samples)
    section = radius**2 / 2.0 - wall.tube.curvature_towards(*samples) * radius**3 / 3.0
    return float(2.0 * np.pi * section.reshape(len(s), -1).mean(axis=1).sum() * s[1])


def _outline(wall: StomachWall, s: np.ndarray, around: float) -> Float[np.ndarray, "n 3"]:
    """Points of the wall without folds, at an angle from the greater curvature [m]."""
    theta = wall.greater(s) + around
    radius = within_bend(wall.envelope(s), wall.tube.curvature_towards(s, theta))
    return wall.tube.points(s, theta, radius)


def _polyline_length(points: Float[np.ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def from_cardia(
    wall: StomachWall, arc_length: Float[np.ndarray, " n"], around: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Distance along and around the wall from the center of the cardia [m].

    Args:
        wall: The stomach.
        arc_length: Arc lengths of the points [m].
        around: Their angles from the greater curvature [rad].
    """
    along = arc_length - wall.parameters.cardia_distance
    return along, 0.5 * wall.parameters.fundus_diameter * wrap(around - np.pi)


def _greater_curvature(
    parameters: StomachParameters, tube: Tube
) -> Callable[[np.ndarray], np.ndarray]:
    """Angle of the outer side of the J at arc lengths, from the plane of the axis."""
    is_in = tube.arc_length <= parameters.length
    points = tube.curve(tube.arc_length[is_in])
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    outward = np.cross(tube.frames[:, :, 2], normal)
    # At the lowest bend the outer side faces downwards.
    lowest = np.argmin(points[:, 2])
    outward *= -np.sign(outward[lowest, 2])
    angle = np.unwrap(
        np.arctan2(
            np.einsum("ij,ij->i", outward, tube.frames[:, :, 1]),
            np.einsum("ij,ij->i", outward, tube.frames[:, :, 0]),
        )
    )
    return lambda arc_length: np.interp(arc_length, tube.arc_length, angle)


def _antral_waves(parameters: StomachParameters, s: np.ndarray) -> np.ndarray:
    """Fraction of the radius taken by two peristaltic rings, deeper towards the pylorus."""
    taken = np.zeros_like(s)
    for position, depth in zip(_WAVES, (0.8, 1.35), strict=True):
        offset = (s - position * parameters.length) / (9 * MM)
        taken += parameters.wave_depth * depth * np.exp(-(offset**2))
    return taken


def _rugae(wall: StomachWall, s: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Height of the longitudinal folds [m].

    The folds are thick and winding on the greater curvature, thin and straight on the lesser, low
    in the antrum, and fork according to the branching waves.
    """
    p = wall.parameters
    on_greater = 0.5 + 0.5 * np.cos(around)
    swing = sum_waves(wall.winding, s, around) * (0.25 + 0.75 * on_greater)
    # Narrower folds on the lesser curvature: the phase changes faster there.
    phase = p.num_rugae * (around - 0.35 * np.sin(around)) + swing
    # Broad cords between narrow, rounded grooves.
    crest = 0.5 + 0.5 * np.cos(phase)
    cord = 1.18 * crest / (crest + 0.18)
    strength = np.clip(0.95 + 0.42 * sum_waves(wall.branching, s, around), 0.12, 1.35)
    strength = strength * (0.45 + 0.55 * on_greater)
    in_antrum = smoothstep((s - 0.62 * p.length) / (0.14 * p.length))
    return p.rugae_height * cord * strength * (1.0 - 0.72 * in_antrum)


def _notch(parameters: StomachParameters, s: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Height of the angular fold across the lesser curvature [m]."""
    offset = (s - _INCISURA * parameters.length) / (9 * MM)
    across = np.clip(np.cos(0.5 * wrap(around - np.pi) * 1.25), 0.0, 1.0) ** 3
    return parameters.incisura_depth * across * np.exp(-(offset**2))


def _cardia(wall: StomachWall, s: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Height of the closed cardia above the wall [m]: a rosette with a dimple at its center."""
    along, across = from_cardia(wall, s, around)
    distance = np.hypot(along, across) / (11 * MM)
    petals = 1.0 + 0.22 * np.cos(6.0 * np.arctan2(across, along)) * np.exp(-((distance - 0.8) ** 2))
    collar = 5.0 * MM * np.exp(-(np.abs(distance) ** 2.5)) * petals
    return collar - 7.5 * MM * np.exp(-((distance / 0.30) ** 2))


def _pyloric_star(wall: StomachWall, s: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Radial folds that run up to the pyloric ring [m]."""
    p = wall.parameters
    before = p.length - 0.5 * _CANAL - s
    near = smoothstep(before / (6 * MM)) * smoothstep((34 * MM - before) / (22 * MM))
    swing = 0.7 * np.sin(s / (11 * MM))
    slack = np.clip(p.rugae_height / (5 * MM), 0.2, 1.2)
    return 2.2 * MM * slack * near * (0.5 + 0.5 * np.cos(6.0 * around + swing)) ** 1.5
