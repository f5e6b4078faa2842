"""Claim: indirect light by radiosity has a small error, at a fraction of a frame's cost.

Renders linear radiance with each setting of light and path tracing, which
`benchmarks.validation.path` compares with Mitsuba 3: error and cost of the same setting stand
side by side. Claimed: by default, over the views of an organ, relative RMSE at most 5 % of the
whole image, and a labeled frame with radiosity takes at most 1.6 times the processor time of one
with direct light and as many shadows. Constants of radiosity were chosen on the first three
organs; the others are held out.

    python -m benchmarks.validation.radiosity
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import DATA, options, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.cli.benchmarks.render import drawn
from vrcaps.cli.benchmarks.report import Spread, Subject, interleave
from vrcaps.cli.benchmarks.stage import Stage, make_stage, resized_camera
from vrcaps.core.units import MM
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.build import build
from vrcaps.scenario.scenario import OrganFile, Scenario

FITTED = (("colon", 0), ("small-bowel", 0), ("stomach", 0))
HELD_OUT = (("colon", 11), ("colon", 12), ("small-bowel", 11), ("stomach", 11), ("stomach", 12))
FILES = ("colon_GI1_mm", "stomach_A_mm")
NUM_VIEWS = 3
SAMPLES = 24
DEPTH = 10
ROUNDS = 9
SETTINGS = {
    f"{light}{', shadows' * shadows}": RenderSettings(light=light, shadows=shadows)
    for light in ("direct", "radiosity")
    for shadows in (False, True)
}
DEFAULT = next(name for name, settings in SETTINGS.items() if settings == RenderSettings())
ERRORS = (
    "organ", "wall", "view", "indirect light", "radiosity / path", "shadows", *SETTINGS,
    f"claimed of {DEFAULT}",
)  # fmt: skip
TIMES = (
    "organ", "wall", "direct [ms]", "radiosity, times that", "direct, shadows [ms]",
    "radiosity, shadows, times that", "times direct without shadows", "claimed",
)  # fmt: skip


@dataclass(frozen=True)
class Scene:
    """Organ, state of its wall, and views."""

    organ: str
    wall: str
    stage: Stage


def squeezed(stage: Stage) -> Stage:
    """Views with a ring of contraction 25 mm ahead of each, by 40 % of the radius."""
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


def scenes() -> Iterator[Scene]:
    """Organs: of the fit, held out, and from CT if present."""
    for kind, seed in FITTED + HELD_OUT:
        stage = make_stage(generate_organ(kind, seed=seed), num_views=NUM_VIEWS)
        name = kind if (kind, seed) in FITTED else f"{kind}, seed {seed}, held out"
        yield Scene(name, "at rest", stage)
        if (kind, seed) in FITTED and kind != "stomach":
            yield Scene(name, "contracted", squeezed(stage))
    for path in (DATA / f"{name}.ply" for name in FILES):
        if path.exists():
            model, _ = build(Scenario(organ=OrganFile(str(path), "mm"), frames=2))
            stage = make_stage(model.organ, num_views=NUM_VIEWS)
            yield Scene(f"{path.stem}, from CT, held out", "at rest", stage)


def errors(scene: Scene, size: int) -> list[tuple[str, ...]]:
    """A row for each view, and one for all."""
    stage = scene.stage
    camera = resized_camera(stage.camera, size)
    paths = [
        RenderSettings(light="path", spp=SAMPLES, max_bounces=DEPTH, path_seed=seed)
        for seed in (1, 2)
    ]
    renderers = [Renderer(stage.model, chosen) for chosen in (*SETTINGS.values(), *paths)]
    images = np.array(
        [
            [r.render(state, camera, channels=("radiance",)).radiance for r in renderers]
            for state in stage.states
        ],
        dtype=float,
    )
    names = (scene.organ, scene.wall)
    rows = [(*names, str(k + 1), *figures(view[None])) for k, view in enumerate(images)]
    return [*rows, (*names, "all", *figures(images))]


def figures(images: np.ndarray) -> tuple[str, ...]:
    """Fractions and errors over views [n 6 h w 3].

    Relative RMSE is the root of the mean squared difference from path tracing over its mean. The
    square is the product of the differences from two renderings of independent noise, whose mean
    holds no noise of theirs. Each view is taken relative to its own mean.
    """
    *ours, one, two = np.moveaxis(images, 1, 0)
    made = dict(zip(SETTINGS, ours, strict=True))
    path, axes = 0.5 * (one + two), (1, 2, 3)
    mean = path.mean(axis=axes)
    direct, radiosity = made["direct, shadows"], made["radiosity, shadows"]
    share = 1.0 - direct.mean(axis=axes) / mean
    ratio = (radiosity - direct).mean(axis=axes) / (path - direct).mean(axis=axes)

    def rmse(square: np.ndarray) -> float:
        return float(np.sqrt(max((square.mean(axis=axes) / mean**2).mean(), 0.0)))

    off = {name: rmse((image - one) * (image - two)) for name, image in made.items()}
    good = off[DEFAULT] <= 0.05
    return (
        f"{100 * share.mean():.0f} %",
        f"{ratio.mean():.3f}",
        f"{100 * rmse((made['direct'] - direct) ** 2):.1f} %",
        *(f"{100 * error:.1f} %" for error in off.values()),
        "" if len(images) == 1 else f"≤ 5 %: {'yes' if good else 'NO'}",
    )


def cost(scene: Scene) -> tuple[str, ...]:
    """Processor time of labeled frames of 320 × 320 pixels, all threads together, in turns."""
    subjects = [
        Subject(name, drawn(scene.stage, settings=settings)) for name, settings in SETTINGS.items()
    ]
    times = interleave(subjects, num_views=NUM_VIEWS, num_rounds=ROUNDS)
    direct, shadowed, radiosity, both = (times[name].cpu for name in SETTINGS)
    over = [Spread.of(a / b) for a, b in ((radiosity, direct), (both, shadowed), (both, direct))]
    shown = [f"{o.median:.2f} ({o.p10:.2f} to {o.p90:.2f})" for o in over]
    good = max(over[0].median, over[1].median) <= 1.6
    return (
        scene.organ,
        scene.wall,
        f"{1e3 * np.median(direct):.1f}",
        shown[0],
        f"{1e3 * np.median(shadowed):.1f}",
        *shown[1:],
        f"≤ 1.6 times the same: {'yes' if good else 'NO'}",
    )


def main() -> None:
    """Compare, time, write the tables."""
    given = options(__doc__ or "", size=160)
    rows, times = [], []
    for scene in scenes():
        rows += errors(scene, given.size)
        times.append(cost(scene))
        print(*rows[-NUM_VIEWS - 1 :], times[-1], sep="\n", flush=True)
    text = f"""## Radiosity

`--light radiosity` against path tracing of {DEPTH} reflections, {given.size} × {given.size}
pixels, the six LEDs of MiroCam, views spread over the organ. Relative RMSE of radiance, direct
light and all, of each setting; *{DEFAULT}* is the default. *Indirect light* is its fraction of the
image, *radiosity / path* the ratio of its means, *shadows* the relative RMSE of direct light
without shadows against direct light with them: the minimum error of a setting without shadows.
*Contracted*: a ring of 40 % of the radius 25 mm ahead, while form factors are known at rest.

{table(ERRORS, rows)}

Processor time of a complete labeled frame, 320 × 320 pixels, median, in brackets p10 to p90, in
turns, arrays reused; the wall of *contracted* is refitted in each frame of all.

{table(TIMES, times)}
"""
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
