"""Small bowel generator: C-shaped duodenum, and jejunum and ileum coiled in the abdomen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.anatomy.catalog import organ_generator
from vrcaps.anatomy.small_bowel.generate import generate_small_bowel as generate_small_bowel
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters as SmallBowelParameters
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from vrcaps.anatomy.full_tract.patient import PatientAnatomy


@organ_generator("small-bowel")
def small_bowel_of(patient: PatientAnatomy) -> OrganSurface:
    """Generate a patient's small bowel between stomach and colon."""
    from vrcaps.anatomy.full_tract.patient import neighboring_organs

    around = neighboring_organs(patient)
    return generate_small_bowel(patient.small_bowel, around, seed=patient.seed)
