"""Stomach generator: J shape, rugae that flatten on filling, antral waves, pyloric ring."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.stomach.generate import generate_stomach as generate_stomach
from vrcaps.anatomy.stomach.parameters import StomachParameters as StomachParameters
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy


@organ_generator("stomach")
def stomach_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's stomach next to the colon."""
    from vrcaps.anatomy.full_tract.patient import stomach_axis

    return generate_stomach(patient.stomach, seed=patient.seed, course=stomach_axis(patient))
