"""Colon course: a centerline through the abdomen with loops and flexures.

A chain through anatomical waypoints grows to the patient's length and buckles. It is held where
the colon is fixed to the body, does not bend more tightly than its own diameter allows, and does
not touch itself. The relaxation uses position-based dynamics (Müller et al. 2007).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.colon.parameters import SEGMENTS
from vrcaps.anatomy.tube_mesh.tube import Course, Unbending, restore_spacing, unbend
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import smoothstep
from vrcaps.core.rng import stream
from vrcaps.core.units import CM, MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.colon.parameters import ColonParameters

FLEXURE_REACH = 5 * CM
"""Half length over which a flexure turns the lumen by more than 90° [m]."""

_SPACING = 12.5 * MM
_GAP = 4 * MM
_NUM_STEPS = 150
_BEND = 1.5
"""Minimum radius of curvature relative to the radius of the lumen."""
_UNBENDING = Unbending((1, 2), strength=0.5, creep=0.02)
_NUM_TRIES, _MAX_MISSING = 80, 2

# Waypoints of the segments in a mean body, patient frame [cm]: x left, y posterior, z up, origin
# at the center of the abdomen at the height of the navel. Each segment starts at the end of the
# previous one.
_WAYPOINTS_CM = (
    [(-9.5, -1.0, -9.5), (-10.8, 0.5, -5.0)],
    [(-11.5, 3.0, 2.0), (-10.8, 3.2, 8.0)],
    [(-9.8, 0.5, 11.5), (-8.0, -3.5, 9.5)],
    [(-4.5, -7.0, 5.0), (0.5, -8.5, 2.0), (6.0, -7.0, 7.0), (9.5, -3.0, 13.5)],
    [(11.5, 2.0, 17.0), (12.8, 5.0, 13.0)],
    [(13.2, 5.0, 5.0), (12.6, 4.0, -5.5)],
    [
        (10.0, -2.0, -11.0),
        (4.0, -5.5, -8.5),
        (-3.0, -4.5, -6.5),
        (-4.5, 0.5, -10.0),
        (-1.0, 4.5, -11.0),
    ],
    [(0.0, 6.8, -15.0), (0.0, 5.5, -19.5), (0.0, 3.4, -21.5), (0.0, 4.8, -24.5)],
)
# Stiffness with which each segment is held to the body (highest for retroperitoneal segments),
# and tendency to form additional flexures (highest for segments with a long mesentery).
_HOLD = (0.08, 0.02, 0.10, 0.002, 0.10, 0.015, 0.002, 0.15)
_MOBILITY = (0.0, 0.5, 0.0, 1.0, 0.0, 0.7, 1.0, 0.0)
_CAVITY_CM = np.array([[-14.5, -10.5, -26.0], [14.5, 7.5, 20.0]])
# Minimum and maximum position of each segment: the transverse colon hangs between the flexures;
# all but the rectum stay above the pelvic floor.
_LOWEST_CM = (-15.0, -15.0, -10.0, -9.0, 0.0, -12.0, -18.0, -26.0)
_HIGHEST_CM = (0.0, 14.0, 14.0, 19.0, 20.0, 18.0, 3.0, -7.0)


def colon_rng(seed: int) -> np.random.Generator:
    """Random generator of a seed's colon (course, then wall), alone or in the full tract."""
    return stream(seed, "colon")


def generate_course(parameters: ColonParameters, rng: np.random.Generator) -> Course:
    """Generate a course of given length and number of flexures, with clearance for the lumen.

    Some lengths rarely form the requested number of flexures. If no attempt does, the nearest
    result is used, at most two off.

    Raises:
        InputError: If no such course fits into the abdomen.
    """
    wanted = float(parameters.flexures - 5)
    nearest, least = None, _MAX_MISSING + 1
    for attempt in range(_NUM_TRIES):
        bends = _draw_bends(parameters, max(round(wanted), 0), rng)
        course = _relax(parameters, bends, 1.0 + min(0.02 * attempt, 0.8), rng)
        missing = parameters.flexures - count_flexures(course)
        if abs(missing) < least and has_clearance(course, parameters):
            nearest, least = course, abs(missing)
        if least == 0:
            break
        wanted = min(wanted + 0.35 * missing, 18.0)
    if nearest is None:
        raise InputError(
            f"Found no course {parameters.length:.2f} m long with {parameters.flexures} flexures. "
            "Allowed: fewer flexures, a smaller diameter, or another seed."
        )
    return nearest


def count_flexures(course: Course) -> int:
    """Number of acute flexures: separate intervals in which the lumen turns by more than 90°."""
    spacing = course.arc_length[-1] / (len(course.points) - 1)
    reach = max(1, round(FLEXURE_REACH / spacing))
    tangents = np.gradient(course.points, axis=0)
    cosine = np.sum(tangents[2 * reach :] * tangents[: -2 * reach], axis=1)
    is_acute = np.concatenate([[False], cosine < 0.0])
    return int(np.sum(is_acute[1:] & ~is_acute[:-1]))


def has_clearance(course: Course, parameters: ColonParameters) -> bool:
    """Check that the lumen fits along the whole course without touching itself."""
    step = max(1, round(6 * MM / course.arc_length[1]))
    points, arc_length = course.points[::step], course.arc_length[::step]
    radius = outer_radius(parameters, arc_length)
    spread = np.linalg.norm(points[:, None] - points, axis=2)
    needed = np.where(_is_apart(arc_length, radius), radius[:, None] + radius + 0.4 * _GAP, 0.0)
    velocity = np.gradient(points, arc_length, axis=0)
    curvature = np.linalg.norm(np.gradient(velocity, arc_length, axis=0), axis=1)
    return bool(np.all(spread >= needed) and np.all(curvature[2:-2] * radius[2:-2] < 1.2))


def outer_radius(
    parameters: ColonParameters, arc_length: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Distance of the outer wall of the haustra from the centerline [m]."""
    return lumen_radius(parameters, arc_length) * (1.0 + parameters.haustra_depth)


def lumen_radius(
    parameters: ColonParameters, arc_length: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Radius of the lumen between folds [m], blended between segments."""
    return blend(parameters, [0.5 * s.diameter for s in parameters.segments], arc_length)


def blend(
    parameters: ColonParameters, values: list[float], arc_length: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Value per segment, constant within segments and blended over 4 cm between them.

    Args:
        parameters: The patient's dimensions.
        values: One value per segment.
        arc_length: Arc length along the centerline [m].
    """
    blended = np.full(np.shape(arc_length), float(values[0]))
    ends = np.cumsum([segment.length for segment in parameters.segments])
    for end, before, after in zip(ends[:-1], values[:-1], values[1:], strict=True):
        blended += (after - before) * smoothstep((arc_length - end) / (4 * CM) + 0.5)
    return blended


def _draw_bends(
    parameters: ColonParameters, num_bends: int, rng: np.random.Generator
) -> np.ndarray:
    """Number of bends to insert into each segment, by its mobility and length."""
    length = np.array([segment.length for segment in parameters.segments])
    capacity = np.round(np.array(_MOBILITY) * length / (8.5 * CM)).astype(int)
    slots = np.repeat(np.arange(len(capacity)), capacity)
    chosen = rng.choice(slots, min(num_bends, len(slots)), replace=False)
    return np.bincount(chosen, minlength=len(capacity))


def _is_apart(arc_length: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Pairs of samples far enough apart along the course to be separable."""
    along = np.abs(arc_length[:, None] - arc_length)
    return along > 0.65 * np.pi * (radius[:, None] + radius)


def _relax(
    parameters: ColonParameters, bends: np.ndarray, swing: float, rng: np.random.Generator
) -> Course:
    """Grow a chain with the given bends, scaled by `swing`, inside the abdomen."""
    num_nodes = round(parameters.length / _SPACING) + 1
    arc_length = np.linspace(0.0, parameters.length, num_nodes)
    ends = np.cumsum([segment.length for segment in parameters.segments])
    segment = np.minimum(np.searchsorted(ends, arc_length), len(ends) - 1)
    anchors = _anchors(parameters, arc_length, segment)
    hold = np.array(_HOLD)[segment][:, None]
    low, high = _cavity(parameters, segment)
    radius = outer_radius(parameters, arc_length)
    nodes = anchors + swing * _meander(anchors, bends, arc_length, segment, rng)
    needed = np.where(_is_apart(arc_length, radius), radius[:, None] + radius + _GAP, 0.0)
    start = np.linalg.norm(np.diff(nodes, axis=0), axis=1).mean()
    for i in range(_NUM_STEPS):
        growth = min(1.0, i / (0.6 * _NUM_STEPS))
        spacing = start + growth * (arc_length[1] - start)
        nodes += (1.0 - 0.85 * growth) * hold * (anchors - nodes)
        nodes += _push_apart(nodes, needed)
        nodes += 0.3 * (np.clip(nodes, low, high) - nodes)
        for _ in range(3):
            nodes += unbend(nodes, _BEND * radius, spacing, _UNBENDING)
            nodes += restore_spacing(nodes, spacing)
    return _smooth_course(nodes, parameters.length)


def _anchors(
    parameters: ColonParameters, arc_length: np.ndarray, segment: np.ndarray
) -> np.ndarray:
    """Positions of the nodes in the textbook abdomen [m], scaled to the length of the colon."""
    anchors = np.empty((len(arc_length), 3))
    end, start = 0.0, _WAYPOINTS_CM[0][0]
    for k, waypoints in enumerate(_WAYPOINTS_CM):
        path = np.array([start, *waypoints[(k == 0) :]])
        chord = _chord_length(path)
        fraction = (arc_length[segment == k] - end) / parameters.segments[k].length
        for axis in range(3):
            anchors[segment == k, axis] = np.interp(fraction * chord[-1], chord, path[:, axis])
        end, start = end + parameters.segments[k].length, waypoints[-1]
    return _body_size(parameters) * CM * anchors


def _meander(
    anchors: np.ndarray,
    bends: np.ndarray,
    arc_length: np.ndarray,
    segment: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Sideways displacement that makes each segment buckle into its number of bends [m].

    A sine of n half-waves and amplitude a over the straight length d has a length of about
    d √(1 + (π n a / d)² / 2); the amplitude takes up most of the segment's excess length.
    """
    offset = 1 * MM * rng.standard_normal(anchors.shape)
    tangents = np.gradient(anchors, axis=0)
    for k, num_bends in enumerate(bends):
        is_in = np.flatnonzero(segment == k)
        fraction = np.linspace(0.0, 1.0, len(is_in))
        straight = np.linalg.norm(np.diff(anchors[is_in], axis=0), axis=1).sum()
        length = arc_length[is_in[-1]] - arc_length[is_in[0]]
        waves = max(num_bends, 1)
        excess = np.sqrt(2.0 * max((length / straight) ** 2 - 1.0, 0.04))
        amplitude = rng.uniform(0.6, 1.1) * straight / (np.pi * waves) * excess
        sideways = np.cross(tangents[is_in], rng.standard_normal(3) * [1.0, 2.0, 1.0])
        sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
        wave = np.sin(np.pi * (waves * fraction + (rng.uniform(-0.2, 0.2) if num_bends else 0.0)))
        envelope = np.minimum(1.0, 8.0 * np.minimum(fraction, 1.0 - fraction))
        offset[is_in] += amplitude * (wave * envelope)[:, None] * sideways
    return offset


def _push_apart(nodes: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Displacement that separates nodes closer to each other than needed [m]."""
    distance = scipy.spatial.distance.cdist(nodes, nodes)
    weight = np.maximum(needed - distance, 0.0) / (distance + 1e-9)
    count = np.maximum(np.count_nonzero(weight, axis=1), 1)
    push = nodes * weight.sum(axis=1)[:, None] - weight @ nodes
    return 0.5 * push / count[:, None]


def _cavity(parameters: ColonParameters, segment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum and maximum coordinates of each node in the abdomen [m]."""
    low, high = (np.repeat(corner[None], len(segment), axis=0) for corner in _CAVITY_CM)
    low[:, 2] = np.array(_LOWEST_CM)[segment]
    high[:, 2] = np.array(_HIGHEST_CM)[segment]
    # The ends of the transverse colon rise to the flexures.
    inside = np.flatnonzero(segment == SEGMENTS.index("transverse"))
    fraction = np.linspace(0.0, 1.0, len(inside))
    high[inside, 2] = np.interp(fraction, [0.0, 0.15, 0.7, 1.0], [13.0, 9.0, 10.0, 19.0])
    size = _body_size(parameters)
    return size * CM * low, size * CM * high


def _body_size(parameters: ColonParameters) -> float:
    """Size of the abdomen relative to the mean: longer colons belong to larger bodies."""
    return float(np.clip(np.sqrt(parameters.length / 1.895), 0.85, 1.1))


def _chord_length(nodes: np.ndarray) -> np.ndarray:
    """Distance of each node from the first along the chain [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])


def _smooth_course(nodes: np.ndarray, length: float) -> Course:
    """Smooth, evenly sampled curve of exactly the given length through the chain."""
    for _ in range(4):
        nodes[1:-1] += 0.25 * (nodes[:-2] - 2.0 * nodes[1:-1] + nodes[2:])
    for _ in range(3):
        chord = _chord_length(nodes)
        nodes = scipy.interpolate.CubicSpline(chord, nodes)(
            np.linspace(0.0, chord[-1], round(length / MM) + 1)
        )
    center = nodes.mean(axis=0)
    nodes = center + (nodes - center) * (length / _chord_length(nodes)[-1])
    return Course(nodes, np.linspace(0.0, length, len(nodes)))
