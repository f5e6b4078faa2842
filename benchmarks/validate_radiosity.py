"""Claim: radiosity is nearly right, at a fraction of a frame's cost.

Renders linear radiance with `light="radiosity"` beside path tracing, which `validate_path.py`
compares with Mitsuba 3. Claimed: over the views of an organ, relative RMSE at most 5 % of the whole
image, and a labeled frame takes at most 1.6 times the processor time of one with direct light.

    python benchmarks/validate_radiosity.py
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from validation import options, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.cli.benchmarks.stage import Stage, make_stage, resized_camera
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.units import MM

ORGANS = ("colon", "small-bowel", "stomach")
NUM_VIEWS = 3
SAMPLES = 24
DEPTH = 10
ROUNDS = 9
DIRECT, RADIOSITY = RenderSettings(light="direct"), RenderSettings(light="radiosity")
ERRORS = (
    "organ", "wall", "view", "indirect light", "radiosity / path", "direct", "radiosity",
    "radiosity, no shadows", "claimed",
)  # fmt: skip
TIMES = ("organ", "wall", "direct [ms]", "radiosity [ms]", "ratio", "p10 to p90", "claimed")


def squeezed(stage: Stage) -> Stage:
    """The same views with a ring of contraction ahead of each: 40 % of the radius, 25 mm off."""
    organ, rest = stage.model.organ, stage.model.vertices_world
    line, T_world_patient = organ.centerline, stage.model.T_world_patient
    middle = [np.interp(organ.arc_length, line.arc_length, line.points[:, k]) for k in range(3)]
    middle = np.stack(middle, axis=1) @ T_world_patient[:3, :3].T + T_world_patient[:3, 3]
    states = []
    for state, share in zip(stage.states, np.linspace(0.05, 0.95, len(stage.states)), strict=True):
        offset = organ.arc_length - share * line.length - 25 * MM
        less = 0.4 * np.exp(-((offset / (15 * MM)) ** 2))[:, None]
        states.append(replace(state, vertices_world=middle + (rest - middle) * (1.0 - less)))
    return replace(stage, states=tuple(states))


def stages() -> Iterator[tuple[str, str, Stage]]:
    """Organ, what its wall does, and the views."""
    for name in ORGANS:
        stage = make_stage(generate_organ(name, seed=0), num_views=NUM_VIEWS)
        yield name, "at rest", stage
        if name != "stomach":
            yield name, "contracted", squeezed(stage)


def errors(names: tuple[str, str], stage: Stage, size: int) -> list[tuple[str, ...]]:
    """A row for each view, and one for all."""
    camera = resized_camera(stage.camera, size)
    paths = [
        RenderSettings(light="path", spp=SAMPLES, max_bounces=DEPTH, path_seed=seed)
        for seed in (1, 2)
    ]
    settings = (replace(DIRECT, shadows=True), replace(RADIOSITY, shadows=True), RADIOSITY, *paths)
    renderers = [Renderer(stage.model, chosen) for chosen in settings]
    images = np.array(
        [
            [r.render(state, camera, channels=("radiance",)).radiance for r in renderers]
            for state in stage.states
        ],
        dtype=float,
    )
    rows = [(*names, str(k + 1), *figures(view[None])) for k, view in enumerate(images)]
    return [*rows, (*names, "all", *figures(images))]


def figures(images: np.ndarray) -> tuple[str, ...]:
    """Shares and errors over views [n 5 h w 3].

    Relative RMSE is the root of the mean squared difference from path tracing over its mean. The
    square is the product of the differences from two renderings of independent noise, whose mean
    holds no noise of theirs. Each view is taken relative to its own mean.
    """
    direct, radiosity, free, one, two = np.moveaxis(images, 1, 0)
    path = 0.5 * (one + two)
    mean = path.mean(axis=(1, 2, 3))
    share = 1.0 - direct.mean(axis=(1, 2, 3)) / mean
    ratio = (radiosity - direct).mean(axis=(1, 2, 3)) / (path - direct).mean(axis=(1, 2, 3))

    def rmse(image: np.ndarray) -> float:
        square = ((image - one) * (image - two)).mean(axis=(1, 2, 3)) / mean**2
        return float(np.sqrt(max(square.mean(), 0.0)))

    return (
        f"{100 * share.mean():.0f} %",
        f"{ratio.mean():.3f}",
        f"{100 * rmse(direct):.1f} %",
        f"{100 * rmse(radiosity):.1f} %",
        f"{100 * rmse(free):.1f} %",
        "" if len(images) == 1 else f"≤ 5 %: {'yes' if rmse(radiosity) <= 0.05 else 'NO'}",
    )


def cost(names: tuple[str, str], stage: Stage) -> tuple[str, ...]:
    """Processor time of labeled frames of 320 × 320 pixels, all threads together."""
    renderers = [Renderer(stage.model, s) for s in (DIRECT, RADIOSITY)]
    taken = np.zeros((ROUNDS, NUM_VIEWS, 2))
    for turn, (view, state) in (
        (turn, pair) for turn in range(ROUNDS) for pair in enumerate(stage.states)
    ):
        for k, renderer in enumerate(renderers):
            start = time.process_time()
            renderer.render(state, stage.camera)
            taken[turn, view, k] = time.process_time() - start
    direct, radiosity = np.median(taken[1:], axis=(0, 1))
    ratios = (taken[1:, :, 1] / taken[1:, :, 0]).ravel()
    low, middle, high = np.quantile(ratios, (0.1, 0.5, 0.9))
    return (
        *names,
        f"{1e3 * direct:.1f}",
        f"{1e3 * radiosity:.1f}",
        f"{middle:.2f}",
        f"{low:.2f} to {high:.2f}",
        f"≤ 1.6: {'yes' if middle <= 1.6 else 'NO'}",
    )


def main() -> None:
    """Compare, time, write the tables."""
    given = options(__doc__ or "", size=160)
    rows, times = [], []
    for organ, wall, stage in stages():
        rows += errors((organ, wall), stage, given.size)
        times.append(cost((organ, wall), stage))
        print(*rows[-NUM_VIEWS - 1 :], times[-1], sep="\n", flush=True)
    text = (
        "## Radiosity\n\n`python benchmarks/validate_radiosity.py`: `--light radiosity` "
        f"against path tracing of {DEPTH} reflections, {given.size} × {given.size} pixels,\nthe "
        "six LEDs of MiroCam, views spread over the organ. Relative RMSE of radiance, direct "
        "light and all; *indirect\nlight* is its share of the image, *radiosity / path* the ratio "
        "of its means. Shadows are on but where said. *Contracted*: a ring\nof 40 % of the radius "
        "25 mm ahead, while what a site sees is known at rest.\n\n"
        + table(ERRORS, rows)
        + "\n\nProcessor time of a complete labeled frame, 320 × 320 pixels, no shadows, medians; "
        "the wall of *contracted* is refitted\nin each frame of both.\n\n" + table(TIMES, times)
    )
    write_section(given.out, Path(__file__).name, text)


if __name__ == "__main__":
    main()
