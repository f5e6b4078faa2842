"""Coarse organs in the place of the catalog's, for tests of programs that take any organ.

A cache folder contains them under the names of organs of the catalog, so a program that generates
one only reads it. Textures that a program bakes itself are coarse by `COARSE_BAKING`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from tests.support.tubes import straight_gut
from vrcaps.core.files import cache_in
from vrcaps.organ.surface import OrganSurface

TEXELS_PER_MM, ATLAS = 1.0, 512
"""Texels of a texture, and width of the atlas in which its charts are packed [texels]."""
COARSE_BAKING = f"""
import vrcaps.mucosa.bake, vrcaps.organ.uv
vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM = {TEXELS_PER_MM}
vrcaps.organ.uv._RESOLUTION = {ATLAS}
"""
"""Statements for the beginning of a program."""

_PLAN = (101_010_639, 125_018_573, 458_834_840)  # first patients of a plan of seed 0
_NAMES = {
    "colon": ((0, None), (0, "normal"), (1, None), (3, None)),
    "stomach": ((0, "inflated"), *((seed, None) for seed in (0, 1, 2, 3, 100, *_PLAN))),
    "small-bowel": ((0, None),),
}
"""Seeds and distensions of the organs of pages, notebooks and examples."""


@pytest.fixture(scope="module", autouse=True)
def coarse_textures() -> Iterator[None]:
    """Textures are coarse in the modules of a folder whose conftest imports this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM", TEXELS_PER_MM)
        patch.setattr("vrcaps.organ.uv._RESOLUTION", ATLAS)
        yield


def fill_cache(folder: Path) -> None:
    """Write coarse organs into a cache folder; those that another process has written stay."""
    from vrcaps.anatomy import catalog

    with cache_in(folder), pytest.MonkeyPatch.context() as patch:
        for name, patients in _NAMES.items():
            catalog._generator(name)  # its module registers it
            patch.setitem(catalog._GENERATORS, name, lambda _, name=name: coarse_organ(name))
            for seed, distension in patients:
                catalog.generate_organ(name, seed=seed, distension=distension)


@cache
def coarse_organ(name: str) -> OrganSurface:
    """Organ of patient 0 with few triangles and texels; the small bowel is a straight tube."""
    from vrcaps.anatomy.colon import generate_colon
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
    from vrcaps.anatomy.stomach import generate_stomach
    from vrcaps.mucosa.bake import bake_appearance
    from vrcaps.organ.segments import ORGANS

    patient = draw_patient_anatomy(0)
    if name == "colon":
        organ = generate_colon(replace(patient.colon, triangles=20_000), seed=0)
    elif name == "stomach":
        organ = generate_stomach(replace(patient.stomach, edge=4e-3), seed=0)
    else:
        organ = straight_gut({"duodenum": 0.2, "jejunum": 0.4, "ileum": 0.4}, edge=4e-3, name=name)
    mucosa = ORGANS[name].mucosa
    look = bake_appearance(organ, seed=0, mucosa=mucosa, texels_per_mm=TEXELS_PER_MM)
    return replace(organ, appearance=look)
