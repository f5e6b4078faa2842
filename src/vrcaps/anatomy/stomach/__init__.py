"""Stomach generator: J shape, rugae that flatten on filling, antral waves, pyloric ring."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.stomach.parameters import SEGMENTS
from vrcaps.anatomy.stomach.parameters import StomachParameters as StomachParameters
from vrcaps.anatomy.stomach.shape import (
    STUB,
    StomachWall,
    cardia_position,
    draw_stomach_wall,
    from_cardia,
    stomach_course,
    stomach_course_rng,
    stomach_radius,
    stomach_wall_rng,
)
from vrcaps.anatomy.tube_mesh.surface_to_organ import first_sound, surface_to_organ
from vrcaps.anatomy.tube_mesh.swept_surface import SweptSurface, dome, wrap
from vrcaps.anatomy.tube_mesh.tube import make_tube
from vrcaps.core.units import MM
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.anatomy.full_tract.patient import PatientAnatomy
    from vrcaps.anatomy.tube_mesh.tube import Course


_NUM_TRIES = 5
_BULB_DEPTH = 8 * MM


def generate_stomach(
    parameters: StomachParameters, *, seed: int, course: Course | None = None
) -> OrganSurface:
    """Generate a stomach with the given dimensions, different for each seed.

    It is closed at the cardia and ends in a closed pouch just beyond the pyloric ring. Its
    centerline connects the two.

    Args:
        parameters: Dimensions of the patient; `StomachParameters.draw` draws a patient.
        seed: Seed of the axis, folds and irregularities.
        course: Axis displaced by other organs; None is that of an isolated stomach.

    Returns:
        Closed surface in the patient frame without self-intersections and without appearance.

    Raises:
        InputError: If no drawn wall is free of self-intersections.
    """
    course = course or stomach_course(parameters, stomach_course_rng(seed))
    tube, rng = make_tube(course), stomach_wall_rng(seed)
    return first_sound(
        [lambda: _as_organ(draw_stomach_wall(parameters, tube, rng), seed)] * _NUM_TRIES,
        f"stomach {parameters.length:.3f} m long and {parameters.body_diameter:.3f} m wide without "
        "self-intersection. Allowed: a smaller diameter, lower rugae or another seed",
    )


def stomach_path(wall: StomachWall) -> Float[np.ndarray, "n 3"]:
    """Points along the lumen from just inside the cardia, joining the axis in the body [m]."""
    p, axis = wall.parameters, wall.tube.curve
    s, theta = cardia_position(wall)
    radius = float(stomach_radius(wall, np.array([s]), np.array([theta]))[0])
    inside = np.linspace(max(radius - 13 * MM, 0.4 * radius), 0.4 * radius, 3)
    at = s + np.array([0.0, 0.035, 0.09]) * p.length
    start = wall.tube.points(at, np.full(3, theta), inside)
    stops = np.arange(s + 0.24 * p.length, p.length + 0.5 * STUB, 6 * MM)
    return np.concatenate([start, axis(stops)])


def stomach_labels(
    wall: StomachWall, arc_length: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
) -> UInt8[np.ndarray, " n"]:
    """Segment label of each point of the wall, 1 for the first of `SEGMENTS`.

    Args:
        wall: The stomach.
        arc_length: Arc length along the axis [m].
        theta: Angle around it [rad].
    """
    p = wall.parameters
    around = wrap(theta - wall.greater(arc_length))
    ends = np.array([p.cardia_distance, 0.66 * p.length, p.length - 22 * MM])
    label = np.array([1, 3, 5, 6])[np.searchsorted(ends, arc_length, side="right")]
    label[np.hypot(*from_cardia(wall, arc_length, around)) < 20 * MM] = 2
    on_lesser = np.abs(around) > 0.62 * np.pi
    label[on_lesser & (np.abs(arc_length - 0.655 * p.length) < 0.06 * p.length)] = 4
    return label.astype(np.uint8)


def _surface(wall: StomachWall) -> SweptSurface:
    """Wall, closed beyond the pyloric ring."""
    end = wall.parameters.length + STUB

    def closed(s: np.ndarray) -> np.ndarray:
        return dome(end - s, _BULB_DEPTH)

    return SweptSurface(
        wall.tube,
        end,
        lambda s: wall.envelope(s) * closed(s),
        lambda s, theta: stomach_radius(wall, s, theta) * closed(s),
        lambda s: np.full_like(s, wall.parameters.edge),
    )


def _as_organ(wall: StomachWall, seed: int) -> OrganSurface:
    """Finished surface with a centerline that starts at the cardia."""
    return surface_to_organ(
        _surface(wall),
        "stomach",
        segments=SEGMENTS,
        label=lambda s, theta: stomach_labels(wall, s, theta),
        metadata={"generator": "stomach", "seed": seed, "parameters": asdict(wall.parameters)},
        path=stomach_path(wall),
    )


@organ_generator("stomach")
def stomach_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's stomach next to the colon."""
    from vrcaps.anatomy.full_tract.patient import stomach_axis

    return generate_stomach(patient.stomach, seed=patient.seed, course=stomach_axis(patient))
