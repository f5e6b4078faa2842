"""Claim: path tracing is unbiased.

Renders linear radiance, also by Mitsuba 3's `path`: same mesh, textures, lights and rays, its
principled BSDF, as many reflections; colors as texels hold them. Claimed: mean radiance within
0.5 %, and nothing but noise in the difference: of the images by blocks, of their means within 3
standard errors.

    python -m benchmarks.validation.path
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from benchmarks.validation.path_scenes import Scene, scenes

BLOCK = 16
"""Width of the blocks of pixels whose means are compared."""
IMAGES = 24
"""Images of each renderer, each with a different seed; their scatter is the noise."""
SAMPLES = 32
TRIALS = 2000
"""Pairs of images of pure noise that the difference is held against."""
DEPTHS = (2, 4)
HEAD = (
    "scene", "reflections", "mean, direct", "mean, ours", "mean, Mitsuba", "ratio", "off by [σ]",
    "blocks", "mean z²", "expected", "z² / expected", "|z| > 3", "p", "claimed",
)  # fmt: skip


def compare(scene: Scene, depth: int) -> tuple[str, ...]:
    """One row of the table."""
    direct = scene.ours(max_bounces=1, spp=1)(0)
    ours, theirs = (
        np.stack([image(seed) for seed in range(IMAGES)])
        for image in (
            scene.ours(max_bounces=depth, spp=SAMPLES),
            scene.theirs(max_bounces=depth, spp=SAMPLES),
        )
    )
    # At an outline a smooth normal can point away: Mitsuba leaves such a pixel black.
    bent = (theirs.max(axis=(0, 3)) == 0.0) & (ours.max(axis=(0, 3)) > 0.0)
    ours[:, bent] = theirs[:, bent] = direct[bent] = 0.0
    a, b = blocks(ours), blocks(theirs)
    z, noise = scores(a, b), noise_scores(a, b)
    chance = np.mean(noise >= np.mean(z**2))
    means = ours.mean(axis=(1, 2, 3)), theirs.mean(axis=(1, 2, 3))
    ratio = means[0].mean() / means[1].mean()
    error = ratio * np.hypot(*(m.std(ddof=1) / m.mean() / np.sqrt(IMAGES) for m in means))
    is_even, is_noise = abs(ratio - 1.0) < 5e-3, chance > 1e-3 and abs(ratio - 1.0) < 3.0 * error
    return (
        scene.name,
        str(depth),
        f"{direct.mean():.4f}",
        f"{means[0].mean():.4f}",
        f"{means[1].mean():.4f}",
        f"{ratio:.5f} ± {error:.5f}",
        f"{(ratio - 1.0) / error:+.1f}",
        str(z.size),
        f"{np.mean(z**2):.2f}",
        f"{np.mean(noise):.2f}",
        f"{np.mean(z**2) / np.mean(noise):.2f}",
        f"{100 * np.mean(np.abs(z) > 3.0):.1f} %",
        f"{chance:.3f}",
        f"≤ 0.5 %: {'yes' if is_even else 'NO'}; noise: {'yes' if is_noise else 'NO'}",
    )


def blocks(images: np.ndarray) -> np.ndarray:
    """Means over square blocks of pixels, by color [images n 3]."""
    count, height, width, _ = images.shape
    rows, columns = height // BLOCK, width // BLOCK
    cut = images[:, : rows * BLOCK, : columns * BLOCK]
    cut = cut.reshape(count, rows, BLOCK, columns, BLOCK, 3).mean(axis=(2, 4))
    cut = cut.reshape(count, -1, 3)
    return cut[:, (cut > 0.0).all(axis=(0, 2))]


def scores(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Differences of the means over images, over their standard errors [n 3]; images first."""
    variance = (a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / len(a)
    return (a.mean(axis=0) - b.mean(axis=0)) / np.sqrt(variance)


def noise_scores(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean z² of images of pure noise [trials].

    Normal noise with the covariance that each block's colors have in the images, so that the few
    images and the noise common to the colors count equally in both.
    """
    rng = np.random.default_rng(0)
    spreads = [(x - x.mean(axis=0)).swapaxes(0, 1) / np.sqrt(len(x) - 1) for x in (a, b)]
    result = []
    for _ in range(TRIALS):
        drawn = [rng.standard_normal((s.shape[0], len(a), len(a))) @ s for s in spreads]
        result.append(np.mean(scores(*(x.swapaxes(0, 1) for x in drawn)) ** 2))
    return np.array(result)


def rounding() -> float:
    """Root mean square of a texel's relative error of color."""
    from tests.support.oracle_mitsuba import stored_color

    linear = (np.arange(20, 236) / 255.0) ** 2.2
    colors = np.repeat(linear[:, None], 3, axis=1)
    return float(np.sqrt(np.mean((stored_color(colors) / colors - 1.0) ** 2)))


def main() -> None:
    """Compare, write the table."""
    given = options(__doc__ or "", size=128)
    rows = []
    for scene in scenes(given.size):
        for depth in DEPTHS:
            rows.append(compare(scene, depth))
            print(*rows[-1], flush=True)
    text = f"""## Path tracing

Linear radiance [W/(sr·m²)] against Mitsuba 3 (`llvm_ad_rgb`, `path`, `principled`), {given.size} ×
{given.size} pixels, {IMAGES} images of {SAMPLES} paths per pixel each; the six LEDs of MiroCam as
points, random coarse textures of color and roughness.

{table(HEAD, rows)}

*Off by*: the ratio minus 1, divided by its standard error; noise stays within 3. z: difference of
the means of a block of {BLOCK} × {BLOCK} pixels in one color, over its standard error from the
scatter of the images. *Expected*: mean z² of noise alone, drawn with the covariance of a block's
colors in the images; p: probability of such a mean z² for noise alone; accepted above 0.001.
Mitsuba's `max_depth` is one more than our reflections, as it counts the way to the eye.

Colors of Mitsuba's texture are rounded as our texels are (square roots in 11, 11 and 10 bits): by
{100 * rounding():.2f} % root mean square here. Without that, blocks that see a few texels differ by
as much, and z² grows with the number of images: 1.6 instead of 1.2 on the colon's flat faces and
1.3 instead of 1.1 on the smooth one, at 24 images of 64 paths.

If a smooth normal faces away from a path, Mitsuba loses the light, while here the normal is bent
(docs/concepts/rendering.md): on the colon's own triangles with smooth normals this is 0.2 % of the
mean, and not noise. With flat faces both integrate the same on just these triangles.
"""
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
