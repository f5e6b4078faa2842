"""Full tract of one patient: stomach, small bowel and colon, separately or as one wall."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy

FULL_TRACT_COLON_TRIANGLES = 150_000
"""Number of triangles of the colon in the joint tract, for the same edge length of 2 mm."""


@organ_generator("full-tract")
def full_tract_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's full tract with the appearance of its parts."""
    from vrcaps.anatomy.full_tract.appearance import with_appearance
    from vrcaps.anatomy.full_tract.generate import generate_full_tract

    colon = replace(patient.colon, triangles=FULL_TRACT_COLON_TRIANGLES)
    organ = generate_full_tract(patient.stomach, patient.small_bowel, colon, seed=patient.seed)
    return with_appearance(organ, seed=patient.seed)
