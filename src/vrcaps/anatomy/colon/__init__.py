"""Colon generator: a patient's colon as a labeled, closed triangle surface."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.colon.course import colon_rng, generate_course
from vrcaps.anatomy.colon.parameters import SEGMENTS
from vrcaps.anatomy.colon.parameters import ColonParameters as ColonParameters
from vrcaps.anatomy.colon.parameters import ColonSegment as ColonSegment
from vrcaps.anatomy.colon.shape import (
    ColonWall,
    draw_colon_wall,
    envelope_radius,
    wall_crests,
    wall_radius,
)
from vrcaps.anatomy.tube_mesh.surface_to_organ import first_sound, surface_to_organ
from vrcaps.anatomy.tube_mesh.swept_surface import SweptSurface
from vrcaps.anatomy.tube_mesh.tube import make_tube
from vrcaps.anatomy.tube_mesh.tube_mesher import count_triangles
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy


_NUM_TRIES = 5
_SPARE = 1.02
"""Ratio of generated to requested triangles, so that there are rarely too few."""


def generate_colon(parameters: ColonParameters, *, seed: int) -> OrganSurface:
    """Generate a colon with the given dimensions, different for each seed.

    Args:
        parameters: Dimensions of the patient; `ColonParameters.draw` draws a patient.
        seed: Seed of the course, folds and irregularities.

    Returns:
        Closed surface in the patient frame without self-intersections and without appearance.

    Raises:
        InputError: If the lumen does not fit into the abdomen.
    """
    rng = colon_rng(seed)

    def draw() -> OrganSurface:
        wall = draw_colon_wall(parameters, make_tube(generate_course(parameters, rng)), rng)
        return surface_to_organ(
            colon_surface(wall),
            "colon",
            segments=SEGMENTS,
            label=lambda s, _: colon_labels(parameters, s),
            metadata={"generator": "colon", "seed": seed, "parameters": asdict(parameters)},
        )

    return first_sound(
        [draw] * _NUM_TRIES,
        f"colon {parameters.length:.2f} m long with {parameters.flexures} flexures without "
        "self-intersection. Allowed: fewer flexures, smaller diameters, or another seed",
    )


def colon_surface(wall: ColonWall) -> SweptSurface:
    """Wall with edge lengths for about the requested number of triangles, longer in wide parts."""
    parameters = wall.parameters
    mean = 0.5 * np.average(
        [segment.diameter for segment in parameters.segments],
        weights=[segment.length for segment in parameters.segments],
    )

    def edge(s: np.ndarray) -> np.ndarray:
        return np.maximum(envelope_radius(parameters, s) / mean, 0.5) ** 0.5

    surface = SweptSurface(
        wall.tube,
        parameters.length,
        lambda s: envelope_radius(parameters, s),
        lambda s, theta: wall_radius(wall, s, theta),
        edge,
        lambda angles: wall_crests(wall, angles),
    )
    scale = np.sqrt(count_triangles(surface) / (_SPARE * parameters.triangles))
    return replace(surface, edge=lambda s: scale * edge(s))


def colon_labels(parameters: ColonParameters, arc_length: np.ndarray) -> np.ndarray:
    """Label of the segment at each arc length [m], 1 for the first of `SEGMENTS`."""
    ends = np.cumsum([segment.length for segment in parameters.segments])[:-1]
    return (1 + np.searchsorted(ends, arc_length, side="right")).astype(np.uint8)


@organ_generator("colon")
def colon_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's colon."""
    return generate_colon(patient.colon, seed=patient.seed)
