"""Patient anatomy: dimensions of a patient's organs, drawn by seed, at a distension."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from vrcaps.anatomy.colon.parameters import SEGMENTS, ColonParameters
from vrcaps.anatomy.distension import at_distension
from vrcaps.anatomy.full_tract.abdomen import (
    draw_colon_placement,
    make_neighboring_organs,
    place_stomach,
)
from vrcaps.anatomy.small_bowel.course import NeighboringOrgans
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
from vrcaps.anatomy.stomach.parameters import StomachParameters
from vrcaps.anatomy.tube_mesh.tube import Course
from vrcaps.core.rng import stream
from vrcaps.core.units import CM

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
        seed: Not negative.
        distension: Distension of all organs, one of `COLON_DISTENSIONS`; None is the default: the
            colon insufflated, the other organs after a drink.

    Raises:
        InputError: If there is no such distension.
    """
    upper, lower = distension or "normal", distension or "inflated"
    return PatientAnatomy(
        seed,
        StomachParameters.draw(stream(seed, "stomach/dimensions")).at(upper),
        SmallBowelParameters.draw(stream(seed, "small-bowel/dimensions")).at(upper),
        colon_at(ColonParameters.draw(stream(seed, "colon/dimensions")), lower),
    )


def widest_diameter(patient: PatientAnatomy, organ: str) -> float:
    """Maximum diameter of an organ of `ORGANS` between its folds [m]."""
    colon = [getattr(patient.colon, name).diameter for name in SEGMENTS]
    found = {"colon": max(colon)}
    for name, part in (("stomach", patient.stomach), ("small-bowel", patient.small_bowel)):
        names = [field.name for field in fields(part) if field.name.endswith("_diameter")]
        found[name] = max(getattr(part, name) for name in names)
    return found.get(organ, max(found.values()))


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
