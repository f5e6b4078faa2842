"""Effect of Open Image Denoise on path tracing: error with and without it, by samples.

Error is the root of the mean squared difference from the truth, over the mean radiance. The truth
has noise too: two images of it that share no path, r and s, give the squared error of an image x as
the mean of (x − r)(x − s), to which their noise adds nothing on average.

    pip install 'vrcaps[denoise]'
    python -m benchmarks.validation.denoise
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from benchmarks.validation.path_scenes import Scene, scenes
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.world.model import Model

SAMPLES = (4, 16, 64)
TRUTH = 64
"""Samples of each of the two images that the truth is known by."""
HEAD = (
    "scene", "samples", "error", "denoised", "ratio", "mean, denoised over truth",
    "processor time [s]", "denoised",
)  # fmt: skip


def compare(scene: Scene) -> list[tuple[str, ...]]:
    """A row for each number of samples."""
    truths = [scene.ours(max_bounces=4, spp=TRUTH)(seed) for seed in (100, 101)]
    mean, rows = np.mean(truths), []
    scene.ours(max_bounces=2, spp=1, denoise=True)(0)  # loads the library
    for samples in SAMPLES:
        cells = []
        for denoise in (False, True):
            draw = scene.ours(max_bounces=4, spp=samples, denoise=denoise)
            started = time.process_time()
            image = draw(0)
            seconds = time.process_time() - started
            square = np.prod([image - truth for truth in truths], axis=0).mean()
            cells.append((np.sqrt(square) / mean, image.mean() / mean, seconds))
        (error, _, seconds), (filtered, ratio, seconds_2) = cells
        rows.append((
            scene.name, str(samples), f"{error:.2%}", f"{filtered:.2%}",
            f"{error / filtered:.1f}", f"{ratio:.4f}", f"{seconds:.2f}", f"{seconds_2:.2f}",
        ))  # fmt: skip
        print(*rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, write the table."""
    given = options(__doc__ or "", size=96)
    rows = []
    for scene in islice(scenes(given.size), 2):
        rows += compare(scene)
    own = generate_organ("colon", seed=0)
    model = Model(own, scene.model.device)
    rows += compare(replace(scene, name="the same, its own mucosa", model=model))
    text = (
        "## Denoised path tracing\n\n`python -m benchmarks.validation.denoise`: "
        f"{given.size} × {given.size} pixels, 4 reflections, one image each; Open Image Denoise\n"
        "through `pyoidn`, on the processor.\n\n"
        + table(HEAD, rows)
        + "\n\nError: root mean square difference from the ground truth, divided by the mean "
        f"radiance, from two images of {TRUTH} samples\n"
        "without common paths, so that their own noise cancels."
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
