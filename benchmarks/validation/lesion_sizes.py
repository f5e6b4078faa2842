"""Claim: lesions of maximum size do not intersect the wall.

Puts the largest lesion that each kind allows into a generated organ, or the largest that fits
there, each a tenth smaller than the one rejected, and counts the pairs of triangles of it that cut
the wall or each other. Claimed: none.

    python -m benchmarks.validation.lesion_sizes
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from benchmarks.validation.lesions import cuts
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.lesion import LesionPair, add_lesions, parse_lesion
from vrcaps.lesion.base import Lesion, SizedLesion, settings_of
from vrcaps.organ.surface import OrganSurface

CASES = {
    "colon": (
        *(f"polyp-{shape}:size=30mm" for shape in ("Ip", "Is", "IIa", "IIb", "IIc")),
        *("angioectasia:size=15mm", "lymphangiectasia:size=30mm", "erosion:size=10mm"),
        *("ulcer-aphthous:size=10mm", "ulcer-deep:size=40mm", "tumor:size=50mm"),
        *("diverticulum:size=15mm", "stricture:length=10cm,narrowing=0.85"),
        *("stricture:length=5mm,narrowing=0.85", "colitis-3:spread=E3"),
        *(f"bleeding-4:variant={number}" for number in (1, 2, 3)),
    ),
    "small-bowel": (
        *("polyp-Ip:size=30mm", "polyp-Is:size=30mm", "tumor:size=50mm", "ulcer-deep:size=40mm"),
        *("diverticulum:size=15mm", "stricture:length=10cm,narrowing=0.85", "bleeding-4"),
    ),
    "stomach": (
        *("polyp-Ip:size=30mm", "tumor:size=50mm", "ulcer-deep:size=40mm"),
        *("diverticulum:size=15mm", "bleeding-4"),
    ),
}


def largest(organ: OrganSurface, lesion: Lesion) -> tuple[Lesion, LesionPair]:
    """Lesion of the requested or largest possible size, and the organ with it."""
    while True:
        try:
            return lesion, add_lesions(organ, [lesion], np.random.default_rng(0))
        except InputError:
            if not isinstance(lesion, SizedLesion):
                raise
            limits = settings_of(type(lesion))["size"].limits
            if limits is None or 0.9 * lesion.size < limits.min:
                raise
            lesion = replace(lesion, size=round(0.9 * lesion.size / MM) * MM)


def row(case: tuple[str, str]) -> tuple[str, ...]:
    """Row of one case."""
    name, text = case
    organ = replace(generate_organ(name, seed=0), appearance=None)
    lesion, patient = largest(organ, parse_lesion(text))
    own = (patient.organ.instance == 1)[patient.organ.faces].any(axis=1)
    size = f"{lesion.size / MM:g} mm" if isinstance(lesion, SizedLesion) else "–"
    return (name, text.replace(":", ", "), size, f"{own.sum():,}", str(cuts(patient)))


def main() -> None:
    """Measure two at a time, write the table as it grows."""
    given = options(__doc__ or "", size=1)
    cases = [(name, text) for name, texts in CASES.items() for text in texts]
    rows = []
    with ProcessPoolExecutor(2) as pool:
        for found in pool.map(row, cases):
            rows.append(found)
            write_section(given.out, Path(__file__), section(rows))


def section(rows: list[tuple[str, ...]]) -> str:
    """Section with the table and its explanation."""
    return (
        "## Lesions of maximum size\n\n`python -m benchmarks.validation.lesion_sizes`: the maximum "
        "size of each kind or,\nif it does not fit into the organ, the maximum that fits, in "
        "steps of a tenth.\n\n"
        + table(("organ", "asked for", "size", "triangles of it", "cuts"), rows)
        + "\n\n*Cuts*: pairs of triangles of the lesion that cut the wall or each other."
    )


if __name__ == "__main__":
    main()
