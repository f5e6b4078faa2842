"""One patient's organs by seed: dimensions drawn from the populations, at a filling."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vrcaps.anatomy.colon.parameters import SEGMENTS, ColonParameters
from vrcaps.anatomy.full_tract.abdomen import draw_colon_place, place_stomach, surroundings
from vrcaps.anatomy.small_bowel.course import Surroundings
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
from vrcaps.anatomy.stomach.parameters import StomachParameters
from vrcaps.anatomy.tube_mesh.tube import Course
from vrcaps.errors import InputError
from vrcaps.units import CM

COLON_CALIBRES = {"inflated": 1.0, "normal": 0.85, "collapsed": 0.65}
"""Calibre of the colon relative to that under gas, for which the published figures hold."""


@dataclass(frozen=True)
class Patient:
    """Dimensions of one patient's organs.

    Attributes:
        seed: Of the patient.
        stomach: Of the stomach.
        small_bowel: Of the small bowel.
        colon: Of the colon.
    """

    seed: int
    stomach: StomachParameters
    small_bowel: SmallBowelParameters
    colon: ColonParameters


def draw_patient(seed: int, condition: str | None = None) -> Patient:
    """The patient of a seed; the same seed is the same patient whatever the organ or filling.

    Args:
        seed: Not negative.
        condition: LumenContents of all organs, one of `COLON_CALIBRES`; None is the usual one, the
            colon under gas and the others after a drink.

    Raises:
        InputError: If there is no such condition.
    """
    upper, lower = condition or "normal", condition or "inflated"
    if lower not in COLON_CALIBRES:
        known = ", ".join(COLON_CALIBRES)
        raise InputError(f"Condition is {condition!r}. Allowed: {known}.")
    return Patient(
        seed,
        StomachParameters.draw(np.random.default_rng([seed, 2])).at(upper),
        SmallBowelParameters.draw(np.random.default_rng([seed, 3])).at(upper),
        colon_at(ColonParameters.draw(np.random.default_rng([seed, 1])), lower),
    )


def colon_at(parameters: ColonParameters, condition: str) -> ColonParameters:
    """The same colon at another filling: narrower, its folds as high as they have room for."""
    factor = COLON_CALIBRES[condition]
    if factor == 1.0:
        return parameters
    segments = {}
    for name in SEGMENTS:
        segment = getattr(parameters, name)
        diameter = max(factor * segment.diameter, 2 * CM)
        height = segment.fold_height * min(1.0, factor / 0.85)
        segments[name] = replace(segment, diameter=diameter, fold_height=height)
    return replace(parameters, **segments)


def stomach_axis(patient: Patient) -> Course:
    """Where the patient's stomach lies, without making the colon's wall."""
    return place_stomach(
        patient.stomach, draw_colon_place(patient.colon, patient.seed), patient.seed
    )


def bowel_surroundings(patient: Patient) -> Surroundings:
    """What the patient's small bowel is laid between, without making the other organs' walls."""
    colon = draw_colon_place(patient.colon, patient.seed)
    return surroundings(colon, patient.stomach, place_stomach(patient.stomach, colon, patient.seed))
