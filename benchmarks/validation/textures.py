"""Textures from photographs: similarity, seams and repetition.

Claim: the step over the edges of a texture that continues is that inside (within 15 %), the highest
autocorrelation beyond a region's side is < 0.25, and the mean color is that of the regions it was
made from within ΔE*ab = 1, the threshold of visible differences.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import DATA, options, table, write_section
from vrcaps.tools.mucosa_from_photos.patches import PhotoScale
from vrcaps.tools.mucosa_from_photos.texture import TextureOptions, make_texture
from vrcaps.tools.photos import read_photos

FRAMES = DATA.parent / "real_frames"
"""Optional photographs by folder; those absent are left out."""

FOLDERS = ("clean_colon", "polyp", "colitis_grade_2", "capsule_bleeding")
FLAT = DATA.parent / "textures" / "small_intestine_mucosa_2048.png"
SEAM, REPETITION, COLOR = 0.15, 0.25, 1.0
HEAD = (
    *("photographs", "texels", "texels/mm", "seam", "repetition", "ΔE of mean"),
    *("contrast, L\\*", "gradients", "CPU time", "claimed"),
)


def row(title: str, path: Path, scale: PhotoScale, recipe: TextureOptions) -> tuple[str, ...]:
    """One row of the table."""
    photos = read_photos([path])
    start = time.process_time()
    work = make_texture(photos, scale, recipe, seed=0)
    seconds = time.process_time() - start
    measures = work.texture.metadata["measures"]
    mean = np.subtract(measures["lab_mean_texture"], measures["lab_mean_source"])
    away = float(np.linalg.norm(mean))
    contrast = measures["lab_std_texture"][0] / measures["lab_std_source"][0]
    seam, repetition = measures["seam_ratio"], measures["repetition"]
    good = abs(seam - 1.0) <= SEAM and repetition < REPETITION and away < COLOR
    return (
        title,
        f"{recipe.size}²",
        f"{1e-3 / work.texture.texel:.1f}",
        f"{seam:.2f}",
        f"{repetition:.3f}",
        f"{away:.2f}",
        f"{contrast:.2f}",
        f"{measures['gradient_distance']:.3f}",
        f"{seconds:.0f} s",
        "yes" if good else "NO",
    )


def main() -> None:
    """Make and measure the textures, write the table."""
    given = options(__doc__ or "", size=2048)
    rows = []
    for name in FOLDERS:
        if (FRAMES / name).exists():
            photographs = f"{name.replace('_', ' ')} ({len(list((FRAMES / name).iterdir()))})"
            scale = PhotoScale(field_width_mm=25 if name.startswith("capsule") else 30)
            rows.append(row(photographs, FRAMES / name, scale, TextureOptions(size=given.size)))
            print(*rows[-1], sep=" | ", flush=True)
    if FLAT.exists():
        recipe = TextureOptions(size=given.size, is_flat=True)
        rows.append(row("a flat texture", FLAT, PhotoScale(mm_per_pixel=1 / 12), recipe))
    text = (
        "## Mucosa from photographs\n\n`python -m benchmarks.validation.textures"
        f" --size {given.size}`: endoscopic frames (their number in brackets)\nto textures, against"
        " the regions that they were quilted from.\n\n"
        + table(HEAD, rows)
        + f"\n\nClaimed: step over the edges over that inside, within {SEAM:.0%}; highest "
        f"autocorrelation beyond a\nregion's side < {REPETITION:g}; ΔE\\*ab of the mean colors < "
        f"{COLOR:g}. Contrast: standard deviation of L\\* over that of\nthe regions; gradients: "
        "distance of the histograms of steps in L\\*, 0 to 1."
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
