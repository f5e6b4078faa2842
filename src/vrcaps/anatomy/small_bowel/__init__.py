"""Small bowel generator: C-shaped duodenum, and jejunum and ileum coiled in the abdomen."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.small_bowel.course import generate_course
from vrcaps.anatomy.small_bowel.parameters import BULB_LENGTH, SEGMENTS
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters as SmallBowelParameters
from vrcaps.anatomy.small_bowel.shape import draw_small_bowel_wall, outer_radius, small_bowel_radius
from vrcaps.anatomy.tube_mesh.surface_to_organ import first_sound, surface_to_organ
from vrcaps.anatomy.tube_mesh.swept_surface import SweptSurface, dome
from vrcaps.anatomy.tube_mesh.tube import make_tube
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.organ.surface import CLOSED_RADIUS, POCKETS, OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.anatomy.full_tract.patient import PatientAnatomy
    from vrcaps.anatomy.small_bowel.course import NeighboringOrgans
    from vrcaps.anatomy.small_bowel.shape import SmallBowelWall
    from vrcaps.anatomy.tube_mesh.tube import Tube


_NUM_TRIES = 3
_NUM_SAMPLES = 400
_DOME = 7 * MM


def generate_small_bowel(
    parameters: SmallBowelParameters, around: NeighboringOrgans, *, seed: int
) -> OrganSurface:
    """Generate a small bowel with the given dimensions between given organs, by seed.

    Args:
        parameters: Dimensions of the patient; `SmallBowelParameters.draw` draws a patient.
        around: Its start and end, and the neighboring organs.
        seed: Seed of the coils, folds and irregularities.

    Returns:
        Closed surface in the patient frame without self-intersections and without appearance.

    Raises:
        InputError: If it does not fit between the organs.
    """
    rng = small_bowel_rng(seed)
    return first_sound(
        [lambda: _as_organ(*lay_small_bowel(parameters, around, rng), seed)] * _NUM_TRIES,
        f"small bowel {parameters.length:.2f} m long without self-intersection. "
        "Allowed: a shorter one, smaller diameters, or another seed",
    )


def small_bowel_rng(seed: int) -> np.random.Generator:
    """Random generator of a seed's small bowel (wall and coils), alone or in the full tract."""
    return stream(seed, "small-bowel/coils")


def lay_small_bowel(
    parameters: SmallBowelParameters, around: NeighboringOrgans, rng: np.random.Generator
) -> tuple[SmallBowelWall, Tube]:
    """Draw a wall and lay it along a course.

    Args:
        parameters: The patient's dimensions.
        around: The neighboring organs.
        rng: Random generator of folds and coils.
    """
    wall = draw_small_bowel_wall(parameters, rng)
    course = generate_course(parameters, outer_radius(wall, _NUM_SAMPLES), around, rng)
    return wall, with_local_bend(make_tube(course))


def with_local_bend(tube: Tube, start: float = 0.0) -> Tube:
    """Tube whose bend is averaged only over millimeters, from an arc length [m] onwards.

    A narrow tube may bend within a few centimeters, which a longer average misses.
    """
    sigma = 2.5 * MM / tube.arc_length[1]
    local = scipy.ndimage.gaussian_filter1d(
        tube.curve(tube.arc_length, 2), sigma, axis=0, mode="nearest"
    )
    return replace(tube, bend=np.where((tube.arc_length < start)[:, None], tube.bend, local))


def small_bowel_labels(
    parameters: SmallBowelParameters, arc_length: Float[np.ndarray, " n"]
) -> UInt8[np.ndarray, " n"]:
    """Segment label at each arc length from the pylorus [m], 1 for the first of `SEGMENTS`."""
    p = parameters
    jejunum_end = p.duodenum_length + p.jejunum_fraction * (p.length - p.duodenum_length)
    ends = np.array([BULB_LENGTH, p.duodenum_length, jejunum_end])
    return (1 + np.searchsorted(ends, arc_length, side="right")).astype(np.uint8)


def wanted_edge(
    wall: SmallBowelWall, arc_length: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Edge length [m] by the lumen's diameter; a camera gets closer to the wall of a narrow one."""
    fraction = wall.envelope(arc_length) / (12.25 * MM)
    return wall.parameters.edge * np.clip(fraction, 0.72, 1.1)


def _as_organ(wall: SmallBowelWall, tube: Tube, seed: int) -> OrganSurface:
    """Finished surface with labels, gut coordinates and centerline."""
    end = float(tube.arc_length[-1])

    def closed(s: np.ndarray) -> np.ndarray:
        return dome(np.minimum(s, end - s), _DOME)

    surface = SweptSurface(
        tube,
        end,
        lambda s: wall.envelope(s) * closed(s),
        lambda s, theta: small_bowel_radius(wall, tube, s, theta) * closed(s),
        lambda s: wanted_edge(wall, s),
    )
    return surface_to_organ(
        surface,
        "small-bowel",
        segments=SEGMENTS,
        label=lambda s, _: small_bowel_labels(wall.parameters, s),
        metadata={
            "generator": "small-bowel",
            "seed": seed,
            "parameters": asdict(wall.parameters),
            CLOSED_RADIUS: wall.parameters.closed_radius,
            POCKETS: wall.parameters.pockets,
        },
    )


@organ_generator("small-bowel")
def small_bowel_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's small bowel between stomach and colon."""
    from vrcaps.anatomy.full_tract.patient import neighboring_organs

    around = neighboring_organs(patient)
    return generate_small_bowel(patient.small_bowel, around, seed=patient.seed)
