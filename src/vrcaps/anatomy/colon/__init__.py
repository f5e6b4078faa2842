"""Colon generator: parameters, course, wall and surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.colon.generate import generate_colon as generate_colon
from vrcaps.anatomy.colon.parameters import ColonParameters as ColonParameters
from vrcaps.anatomy.colon.parameters import ColonSegment as ColonSegment
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy


@organ_generator("colon")
def colon_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's colon."""
    return generate_colon(patient.colon, seed=patient.seed)
