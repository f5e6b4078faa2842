"""Patient anatomy: a patient's organs, drawn by seed, and their positions in the abdomen."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.colon.course import colon_rng, generate_course, outer_radius
from vrcaps.anatomy.colon.parameters import SEGMENTS, ColonParameters
from vrcaps.anatomy.small_bowel.course import NeighboringOrgans
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
from vrcaps.anatomy.stomach.parameters import StomachParameters
from vrcaps.anatomy.stomach.shape import stomach_course, stomach_course_rng, stomach_envelope
from vrcaps.anatomy.tube_mesh.tube import (
    Course,
    ObstacleSpheres,
    TubeChain,
    make_tube,
    relax_chain,
    smooth_course,
)
from vrcaps.core.rng import stream
from vrcaps.core.units import CM, MM
from vrcaps.organ.segments import at_distension

if TYPE_CHECKING:
    from jaxtyping import Float


_STEP = 8 * MM
_NODE = 12 * MM
_BULB, _BULB_RADIUS = 5 * CM, 23 * MM
GAP = 4 * MM
"""Clearance between the mean outlines of stomach and colon [m]."""
VALVE_DEPTH = 7 * MM
"""Depth inside the colon's outline at which the small bowel ends, on the lips of the valve [m]."""


@dataclass(frozen=True)
class ColonPlacement:
    """Placement of a colon, as needed by other organs.

    Attributes:
        course: Centerline of the colon.
        radius: Outer radius at each sample [m].
        valve: Center of the ileocaecal valve at the level of the wall [m].
        inward: Unit direction through the valve into the colon.
        along: Unit direction along the colon at the valve, towards the anus.
        size: Size of the abdomen relative to the mean.
    """

    course: Course
    radius: Float[np.ndarray, " n"]
    valve: Float[np.ndarray, " 3"]
    inward: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    size: float


def place_colon(parameters: ColonParameters, course: Course) -> ColonPlacement:
    """Compute the placement of a colon from its dimensions and course."""
    tube = make_tube(course)
    radius = outer_radius(parameters, course.arc_length)
    at = int(np.argmin(np.abs(course.arc_length - parameters.caecum.length)))
    frame = tube.frames[at]
    # Same direction as in the generator: medial, slightly posterior.
    theta = tube.angle_of(parameters.caecum.length, np.array([1.0, 0.4, 0.0]))
    outward = np.cos(theta) * frame[:, 0] + np.sin(theta) * frame[:, 1]
    plain = 0.5 * (parameters.caecum.diameter + parameters.ascending.diameter) / 2.0
    valve = course.points[at] + plain * outward
    size = float(np.clip(np.sqrt(parameters.length / 1.895), 0.85, 1.1))
    return ColonPlacement(course, radius, valve, -outward, frame[:, 2], size)


def draw_colon_placement(parameters: ColonParameters, seed: int) -> ColonPlacement:
    """Compute the placement of a seed's colon without its wall."""
    tube = make_tube(generate_course(parameters, colon_rng(seed)))
    # Points identical, to the last bit, to the centerline of the finished colon.
    return place_colon(parameters, Course(tube.curve(tube.arc_length), tube.arc_length))


def place_stomach(
    parameters: StomachParameters, colon: ColonPlacement, seed: int, *, gap: float = GAP
) -> Course:
    """Axis of a seed's stomach and of the duodenal bulb, with a gap [m] to the colon.

    Args:
        parameters: The patient's stomach.
        colon: Placement of the colon.
        seed: Seed of the stomach.
        gap: Clearance to the colon [m].
    """
    plain = stomach_course(parameters, stomach_course_rng(seed))
    length = float(plain.arc_length[-1])
    num = round((length + _BULB) / _NODE) + 1
    s = np.linspace(0.0, length + _BULB, num)
    nodes = np.stack([np.interp(s, plain.arc_length, plain.points[:, k]) for k in range(3)], axis=1)
    nodes += np.maximum(s - length, 0.0)[:, None] * _towards_duodenum(plain)
    radius = stomach_envelope(parameters)(np.clip(s, 0.3 * parameters.fundus_diameter, None))
    # The duodenum needs space at the end of the stomach.
    radius = np.maximum(1.04 * radius, _BULB_RADIUS)
    chain = TubeChain(
        radius=radius,
        anchor=nodes,
        hold=np.full(num, 0.03),
        reach=np.full(num, 12 * CM),
        is_fixed=np.zeros(num, bool),
        low=np.array([-12.0, -9.0, 4.0]) * CM,
        high=np.array([10.0, 7.0, 27.0]) * CM,
        gap=gap,
    )
    nodes = relax_chain(chain, nodes, s[1], colon_spheres(colon), num_steps=200)
    course = smooth_course(nodes)
    # Restore the patient's length, which relaxation changes by about a percent.
    scale = s[-1] / course.arc_length[-1]
    pivot = course.points[len(course.points) // 2]
    return Course(pivot + scale * (course.points - pivot), scale * course.arc_length)


def pylorus_sample(parameters: StomachParameters, axis: Course) -> int:
    """Index of the axis sample at the pyloric ring, where the small bowel starts."""
    return int(np.argmin(np.abs(axis.arc_length - parameters.length)))


def _towards_duodenum(course: Course) -> Float[np.ndarray, " 3"]:
    """Unit direction of the bulb: onwards from the pylorus, turning right, posterior and down."""
    onward = course.points[-1] - course.points[-5]
    direction = onward / np.linalg.norm(onward) + np.array([-0.2, 0.7, -0.4])
    return direction / np.linalg.norm(direction)


def colon_spheres(colon: ColonPlacement) -> ObstacleSpheres:
    """Spheres that cover the colon."""
    step = round(_STEP / colon.course.arc_length[1])
    return ObstacleSpheres(colon.course.points[::step], colon.radius[::step])


def stomach_spheres(parameters: StomachParameters, course: Course) -> ObstacleSpheres:
    """Spheres that cover the stomach up to the pyloric canal."""
    step = max(1, round(_STEP / course.arc_length[1]))
    s = course.arc_length[::step]
    # No sphere may extend beyond the pyloric ring, where the small bowel starts.
    reach = 0.95 * np.maximum(parameters.length - s, 0.0)
    radius = np.minimum(stomach_envelope(parameters)(np.maximum(s, 2 * CM)), reach)
    inside = s < parameters.length - 12 * MM
    return ObstacleSpheres(course.points[::step][inside], 1.03 * radius[inside])


def make_neighboring_organs(
    colon: ColonPlacement, stomach: StomachParameters, stomach_at: Course
) -> NeighboringOrgans:
    """Neighboring organs of a patient's small bowel.

    Args:
        colon: Placement of the colon.
        stomach: The patient's stomach.
        stomach_at: Axis of the stomach.
    """
    end = pylorus_sample(stomach, stomach_at)
    direction = stomach_at.points[end] - stomach_at.points[end - 4]
    return NeighboringOrgans(
        pylorus=stomach_at.points[end],
        pylorus_direction=direction / np.linalg.norm(direction),
        beyond=stomach_at.points[-1],
        valve=colon.valve + VALVE_DEPTH * colon.inward,
        valve_direction=colon.inward,
        obstacles=colon_spheres(colon) + stomach_spheres(stomach, stomach_at),
        size=colon.size,
    )


COLON_DISTENSIONS = {"inflated": 1.0, "normal": 0.85, "collapsed": 0.65}
"""Diameters of the colon relative to the insufflated one, to which published values refer."""

_PLEATED_TRIANGLES = 2
"""Triangles of a closed colon per triangle of an open one, as pleats are narrower than folds."""


@dataclass(frozen=True)
class PatientAnatomy:
    """Dimensions of one patient's organs.

    Attributes:
        seed: Seed of the patient.
        stomach: Dimensions of the stomach.
        small_bowel: Dimensions of the small bowel.
        colon: Dimensions of the colon.
    """

    seed: int
    stomach: StomachParameters
    small_bowel: SmallBowelParameters
    colon: ColonParameters


def draw_patient_anatomy(seed: int, distension: str | None = None) -> PatientAnatomy:
    """Draw the patient of a seed, the same for every organ and distension.

    Args:
        seed: Seed of the patient, 0 or more.
        distension: Distension of all organs, one of `COLON_DISTENSIONS`; None is the default: the
            colon insufflated, the stomach after a drink, the small bowel fasting, so slack.

    Raises:
        InputError: If there is no such distension.
    """
    upper, lower = distension or "normal", distension or "inflated"
    middle = distension or "collapsed"
    return PatientAnatomy(
        seed,
        StomachParameters.draw(stream(seed, "stomach/dimensions")).at(upper),
        SmallBowelParameters.draw(stream(seed, "small-bowel/dimensions")).at(middle),
        colon_at(ColonParameters.draw(stream(seed, "colon/dimensions")), lower),
    )


def widest_diameter(patient: PatientAnatomy, organ: str) -> float:
    """Maximum diameter of an organ of `ORGANS` between its folds [m]."""
    colon = [getattr(patient.colon, name).diameter for name in SEGMENTS]
    diameters = {"colon": max(colon)}
    for name, part in (("stomach", patient.stomach), ("small-bowel", patient.small_bowel)):
        names = [field.name for field in fields(part) if field.name.endswith("_diameter")]
        diameters[name] = max(getattr(part, name) for name in names)
    return diameters.get(organ, max(diameters.values()))


def colon_at(parameters: ColonParameters, distension: str) -> ColonParameters:
    """The same colon at another distension: narrower, with folds as high as the lumen permits.

    A collapsed colon is closed between gas pockets.
    """
    factor = at_distension(COLON_DISTENSIONS, distension)
    if factor == 1.0:
        return parameters
    segments = {}
    for name in SEGMENTS:
        segment = getattr(parameters, name)
        diameter = max(factor * segment.diameter, 2 * CM)
        height = segment.fold_height * min(1.0, factor / 0.85)
        segments[name] = replace(segment, diameter=diameter, fold_height=height)
    if distension == "collapsed":
        triangles = _PLEATED_TRIANGLES * parameters.triangles
        return replace(parameters, **segments, closing=1.0, triangles=triangles)
    return replace(parameters, **segments)


def stomach_axis(patient: PatientAnatomy) -> Course:
    """Axis of the patient's stomach, without generating the wall of the colon."""
    return place_stomach(
        patient.stomach, draw_colon_placement(patient.colon, patient.seed), patient.seed
    )


def neighboring_organs(patient: PatientAnatomy) -> NeighboringOrgans:
    """Neighboring organs of the patient's small bowel, without generating their walls."""
    colon = draw_colon_placement(patient.colon, patient.seed)
    return make_neighboring_organs(
        colon, patient.stomach, place_stomach(patient.stomach, colon, patient.seed)
    )
