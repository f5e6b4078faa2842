"""Claim: every generated wall has at least 8 texels per mm on 95 % of its area, baked in 30 s.

Density is that in the direction in which a face's texels are widest; 8 bytes per texel are held by
the organ, and 10.7 by a renderer with its mip levels. Writes a table into
docs/concepts/mucosa.md: ``python -m benchmarks.speed.bake``.
"""

from __future__ import annotations

import argparse
import gc
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import ROOT, table, write_section
from vrcaps.anatomy.colon import generate_colon
from vrcaps.anatomy.full_tract import FULL_TRACT_COLON_TRIANGLES, generate_full_tract
from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, neighboring_organs
from vrcaps.anatomy.full_tract.textures import with_appearance
from vrcaps.anatomy.small_bowel import generate_small_bowel
from vrcaps.anatomy.stomach import generate_stomach
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh, face_areas
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.uv import texture_stretch

ORGANS = ("stomach", "small-bowel", "colon", "full-tract")
HEAD = ("wall", "area", "texels", "texels per mm, 5 % / median", "stretch, median / 95 %")
HEAD += ("bake", "organ + renderer")


def generate(name: str, seed: int) -> OrganSurface:
    """A patient's wall without textures."""
    patient = draw_patient_anatomy(seed)
    if name == "stomach":
        return generate_stomach(patient.stomach, seed=seed)
    if name == "small-bowel":
        surroundings = neighboring_organs(patient)
        return generate_small_bowel(patient.small_bowel, surroundings, seed=seed)
    if name == "colon":
        return generate_colon(patient.colon, seed=seed)
    colon = replace(patient.colon, triangles=FULL_TRACT_COLON_TRIANGLES)
    return generate_full_tract(patient.stomach, patient.small_bowel, colon, seed=seed)


def bake(name: str, organ: OrganSurface, seed: int) -> OrganSurface:
    """The wall with textures."""
    if name == "full-tract":
        return with_appearance(organ, seed=seed)
    mucosa = {"small-bowel": "small-bowel"}.get(name, name)
    return replace(organ, appearance=bake_appearance(organ, seed=seed, mucosa=mucosa))


def quantiles(values: np.ndarray, area: np.ndarray, fractions: tuple[float, ...]) -> list[float]:
    """Values that these fractions of the area stay below."""
    order = np.argsort(values)
    below = np.cumsum(area[order]) / area.sum()
    return [float(values[order][np.searchsorted(below, fraction)]) for fraction in fractions]


def row(name: str, organ: OrganSurface, seconds: float) -> tuple[str, ...]:
    """Measures of one baked wall."""
    assert organ.appearance is not None
    height, width = organ.appearance.roughness.shape
    stretch = texture_stretch(organ.vertices[organ.faces], organ.uv * [width, height])
    area = face_areas(Mesh(organ.vertices, organ.faces))
    low, middle = quantiles(stretch[:, 0] * MM, area, (0.05, 0.5))
    ratio, most = quantiles(stretch[:, 1] / stretch[:, 0], area, (0.5, 0.95))
    return (
        name,
        f"{area.sum() * 1e4:.0f} cm²",
        f"{width} × {height}",
        f"{low:.1f} / {middle:.1f}",
        f"{ratio:.2f} / {most:.2f}",
        f"{seconds:.1f} s",
        f"{8e-6 * width * height:.0f} + {8e-6 * 4.0 / 3.0 * width * height:.0f} MB",
    )


def main() -> None:
    """Bake each wall of a patient and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("organs", nargs="*", default=ORGANS, help=f"of {', '.join(ORGANS)}")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "concepts" / "mucosa.md")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.organs:
        organ = generate(name, arguments.seed)
        start = time.perf_counter()
        baked = bake(name, organ, arguments.seed)
        rows.append(row(name, baked, time.perf_counter() - start))
        del organ, baked
        gc.collect()
    write_section(arguments.out, Path(__file__), f"## Density and time\n\n{table(HEAD, rows)}")


if __name__ == "__main__":
    main()
