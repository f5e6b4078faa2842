"""Placement of one patient's stomach and colon, and the space they leave to the small bowel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.colon.course import colon_rng, generate_course, outer_radius
from vrcaps.anatomy.small_bowel.course import NeighboringOrgans
from vrcaps.anatomy.stomach.shape import stomach_course, stomach_course_rng, stomach_envelope
from vrcaps.anatomy.tube_mesh.tube import Course, make_tube
from vrcaps.anatomy.tube_mesh.tube_packing import (
    ObstacleSpheres,
    TubeChain,
    relax_chain,
    smooth_course,
)
from vrcaps.units import CM, MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.colon.parameters import ColonParameters
    from vrcaps.anatomy.stomach.parameters import StomachParameters

_STEP = 8 * MM
_NODE = 12 * MM
_BULB, _BULB_RADIUS = 5 * CM, 23 * MM
GAP = 4 * MM
"""Clearance between the mean outlines of stomach and colon [m]."""
VALVE_DEPTH = 7 * MM
"""The small bowel ends this far inside the colon's outline, on the lips of the valve [m]."""


@dataclass(frozen=True)
class ColonPlacement:
    """Where a colon lies, as far as other organs must know.

    Attributes:
        course: Its centerline.
        radius: Of its outside at each sample [m].
        valve: Middle of the ileocaecal valve at the level of the wall [m].
        inward: Unit direction through the valve into the colon.
        along: Unit direction along the colon there, towards the anus.
        size: Of the abdomen relative to the mean.
    """

    course: Course
    radius: Float[np.ndarray, " n"]
    valve: Float[np.ndarray, " 3"]
    inward: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    size: float


def place_colon(parameters: ColonParameters, course: Course) -> ColonPlacement:
    """A colon's placement from its dimensions and course."""
    tube = make_tube(course)
    radius = outer_radius(parameters, course.arc_length)
    at = int(np.argmin(np.abs(course.arc_length - parameters.caecum.length)))
    frame = tube.frames[at]
    # The same direction as the generator's: medial, slightly posterior.
    theta = tube.angle_of(parameters.caecum.length, np.array([1.0, 0.4, 0.0]))
    outward = np.cos(theta) * frame[:, 0] + np.sin(theta) * frame[:, 1]
    plain = 0.5 * (parameters.caecum.diameter + parameters.ascending.diameter) / 2.0
    valve = course.points[at] + plain * outward
    size = float(np.clip(np.sqrt(parameters.length / 1.895), 0.85, 1.1))
    return ColonPlacement(course, radius, valve, -outward, frame[:, 2], size)


def draw_colon_placement(parameters: ColonParameters, seed: int) -> ColonPlacement:
    """Where the colon of a seed lies, without making its wall."""
    tube = make_tube(generate_course(parameters, colon_rng(seed)))
    # The same points, to the last bit, as the centerline of the finished colon.
    return place_colon(parameters, Course(tube.curve(tube.arc_length), tube.arc_length))


def place_stomach(
    parameters: StomachParameters, colon: ColonPlacement, seed: int, *, gap: float = GAP
) -> Course:
    """The axis of a seed's stomach and of the duodenal bulb, a gap [m] clear of the colon.

    Args:
        parameters: The patient's stomach.
        colon: Where the colon lies.
        seed: Of the stomach.
        gap: Clearance to the colon [m].
    """
    plain = stomach_course(parameters, stomach_course_rng(seed))
    length = float(plain.arc_length[-1])
    num = round((length + _BULB) / _NODE) + 1
    s = np.linspace(0.0, length + _BULB, num)
    nodes = np.stack([np.interp(s, plain.arc_length, plain.points[:, k]) for k in range(3)], axis=1)
    nodes += np.maximum(s - length, 0.0)[:, None] * _towards_duodenum(plain)
    radius = stomach_envelope(parameters)(np.clip(s, 0.3 * parameters.fundus_diameter, None))
    # The duodenum needs space where the stomach ends.
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
    # Its length is the patient's: what relaxation changed by a percent is scaled back.
    scale = s[-1] / course.arc_length[-1]
    pivot = course.points[len(course.points) // 2]
    return Course(pivot + scale * (course.points - pivot), scale * course.arc_length)


def pylorus_sample(parameters: StomachParameters, axis: Course) -> int:
    """Number of the axis's sample at the pyloric ring, where the small bowel begins."""
    return int(np.argmin(np.abs(axis.arc_length - parameters.length)))


def _towards_duodenum(course: Course) -> Float[np.ndarray, " 3"]:
    """Direction of the bulb [unit]: on from the pylorus, turning to the right, back and down."""
    onward = course.points[-1] - course.points[-5]
    direction = onward / np.linalg.norm(onward) + np.array([-0.2, 0.7, -0.4])
    return direction / np.linalg.norm(direction)


def colon_spheres(colon: ColonPlacement) -> ObstacleSpheres:
    """Space the colon takes."""
    step = round(_STEP / colon.course.arc_length[1])
    return ObstacleSpheres(colon.course.points[::step], colon.radius[::step])


def stomach_spheres(parameters: StomachParameters, course: Course) -> ObstacleSpheres:
    """Space the stomach takes, up to the pyloric canal."""
    step = max(1, round(_STEP / course.arc_length[1]))
    s = course.arc_length[::step]
    # A sphere must not reach beyond the pyloric ring, where the small bowel begins.
    reach = 0.95 * np.maximum(parameters.length - s, 0.0)
    radius = np.minimum(stomach_envelope(parameters)(np.maximum(s, 2 * CM)), reach)
    inside = s < parameters.length - 12 * MM
    return ObstacleSpheres(course.points[::step][inside], 1.03 * radius[inside])


def make_neighboring_organs(
    colon: ColonPlacement, stomach: StomachParameters, stomach_at: Course
) -> NeighboringOrgans:
    """What a patient's small bowel is laid between.

    Args:
        colon: Where the colon lies.
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
