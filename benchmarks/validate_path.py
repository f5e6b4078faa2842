"""Claim: path tracing is right.

Renders linear radiance beside Mitsuba 3's `path`: same mesh, textures, lights and rays, its
principled BSDF, as many reflections. Claimed: mean radiance within 0.5 %, and nothing but noise in
the difference of the images.

    python benchmarks/validate_path.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from path_scenes import Scene, scenes
from scipy import stats
from validation import options, table, write_section

BLOCK = 16
"""Width of the blocks of pixels whose means are compared."""
IMAGES = 8
"""Images of each renderer, each of its own seed; their scatter is the noise."""
SAMPLES = 32
DEPTHS = (2, 4)
HEAD = (
    "scene", "reflections", "mean, direct", "mean, ours", "mean, Mitsuba", "ratio", "blocks",
    "mean z²", "expected", "|z| > 3", "p", "claimed",
)  # fmt: skip


def compare(scene: Scene, depth: int) -> tuple[str, ...]:
    """One row of the table.

    z is the difference of a block's means over its standard error, by Welch's formula. Were there
    nothing but noise, z² had the mean ν/(ν − 2) of Student's distribution squared. p is the chance
    of so large a mean z², or larger, by simulation of as many blocks of noise.
    """
    direct = scene.ours(depth=1, samples=1)(0)
    ours, theirs = (
        np.stack([image(seed) for seed in range(IMAGES)])
        for image in (
            scene.ours(depth=depth, samples=SAMPLES),
            scene.theirs(depth=depth, samples=SAMPLES),
        )
    )
    # At an outline a smooth normal can point away: Mitsuba leaves such a pixel black.
    bent = (theirs.max(axis=(0, 3)) == 0.0) & (ours.max(axis=(0, 3)) > 0.0)
    ours[:, bent] = theirs[:, bent] = direct[bent] = 0.0
    a, b = blocks(ours), blocks(theirs)
    variances = a.var(axis=0, ddof=1) / IMAGES, b.var(axis=0, ddof=1) / IMAGES
    total = variances[0] + variances[1]
    z = (a.mean(axis=0) - b.mean(axis=0)) / np.sqrt(total)
    freedom = total**2 * (IMAGES - 1) / (variances[0] ** 2 + variances[1] ** 2)
    expected = np.mean(freedom / (freedom - 2.0))
    rng = np.random.default_rng(0)
    noise = np.mean(stats.t.rvs(freedom, size=(4000, len(freedom)), random_state=rng) ** 2, axis=1)
    chance = np.mean(noise >= np.mean(z**2))
    means = ours.mean(axis=(1, 2, 3)), theirs.mean(axis=(1, 2, 3))
    ratio = means[0].mean() / means[1].mean()
    error = ratio * np.hypot(*(m.std(ddof=1) / m.mean() / np.sqrt(IMAGES) for m in means))
    is_even, is_noise = abs(ratio - 1.0) < 5e-3, chance > 1e-3
    return (
        scene.name,
        str(depth),
        f"{direct.mean():.4f}",
        f"{means[0].mean():.4f}",
        f"{means[1].mean():.4f}",
        f"{ratio:.5f} ± {error:.5f}",
        str(len(z)),
        f"{np.mean(z**2):.2f}",
        f"{expected:.2f}",
        f"{100 * np.mean(np.abs(z) > 3.0):.1f} %",
        f"{chance:.3f}",
        f"≤ 0.5 %: {'yes' if is_even else 'NO'}; noise: {'yes' if is_noise else 'NO'}",
    )


def blocks(images: np.ndarray) -> np.ndarray:
    """Means over square blocks of pixels, by colour [images n]."""
    count, height, width, _ = images.shape
    rows, columns = height // BLOCK, width // BLOCK
    cut = images[:, : rows * BLOCK, : columns * BLOCK]
    cut = cut.reshape(count, rows, BLOCK, columns, BLOCK, 3).mean(axis=(2, 4)).reshape(count, -1)
    return cut[:, (cut > 0.0).all(axis=0)]


def main() -> None:
    """Compare, write the table."""
    given = options(__doc__ or "", size=128)
    rows = []
    for scene in scenes(given.size):
        for depth in DEPTHS:
            rows.append(compare(scene, depth))
            print(*rows[-1], flush=True)
    text = (
        "## Path tracing\n\n`python benchmarks/validate_path.py`: linear radiance [W/(sr·m²)] "
        "against Mitsuba 3 (`llvm_ad_rgb`, `path`,\n`principled`), "
        f"{given.size} × {given.size} pixels, {IMAGES} images of {SAMPLES} paths a pixel each; "
        "the six LEDs of MiroCam as\npoints, random coarse textures of colour and roughness.\n\n"
        + table(HEAD, rows)
        + f"\n\nz: difference of the means of a block of {BLOCK} × {BLOCK} pixels in one colour, "
        "over its standard error from the\nscatter of the images. *Expected*: mean z² of nothing "
        "but noise (Student); p: chance that noise has so large\na mean z². Mitsuba's `max_depth` "
        "is one more than our reflections, as it counts the way to the eye. Where\na smooth "
        "normal faces away from a path, Mitsuba loses the light, while here the normal is bent "
        "(docs/rendering.md):\non the colon's own triangles this is more than noise."
    )
    write_section(given.out, Path(__file__).name, text)


if __name__ == "__main__":
    main()
