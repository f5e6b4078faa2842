"""Claim: 45 or more frames per second with every effect at severity 2 and radiosity.

A flight at 2 cm/s through a generated colon, 320 x 320 pixels, color and four labels: the plain
frame, with indirect light, with lens and sensor, and with both; and each effect by itself. No
sensor of fewer pixels, so that all have the same size. Subjects alternate; the C library keeps
freed memory, so that all frames are rendered into reused buffers. Then recorded into files, as
`vrcaps record` does.

    python -m benchmarks.speed.effects
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.camera_pipeline.effects import SEVERITIES, parse_effects
from vrcaps.cli.benchmarks.report import Spread, Subject, Times, interleave, ratio
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.recording.recorder import record
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.build import build, resolve
from vrcaps.scenario.scenario import Scenario

FRAMES, RECORDED = 30, 200
ROUNDS = 15
EFFECTS = "all=2,resolution=0"
EVERY = "every effect at severity 2"
DEFAULT = RenderSettings()
LIGHTS = {
    "direct light": RenderSettings(light="direct", shadows=False),
    "radiosity": RenderSettings(light="radiosity", shadows=False),
    "direct light, shadows": RenderSettings(light="direct", shadows=True),
    "radiosity, shadows": RenderSettings(light="radiosity", shadows=True),
}
HEAD = (
    "frame", "time [ms]", "frames per second", "processor time [ms]", "times plain",
    "times the same light without effects", "claimed",
)  # fmt: skip
ALONE = ("effect", "longer by [ms]", "processor time more [ms]", "times plain")
KEEP_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**30), "MALLOC_TRIM_THRESHOLD_": str(2**40)}
"""For glibc: freed memory stays with the process, and no frame waits for new pages."""


def main() -> None:
    """Measure all in turns, and write the tables."""
    args = parser(__doc__ or "").parse_args()
    if sys.platform == "linux" and not KEEP_MEMORY.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | KEEP_MEMORY)
    whole = {
        (f"{EVERY}, " if effects else "") + name: (effects, light)
        for effects in ("", EFFECTS)
        for name, light in LIGHTS.items()
    }
    single = {name: f"{name}=2" for name in SEVERITIES if name != "resolution"}
    single["bayer_filter"] = "bayer=rggb"
    plain = LIGHTS["direct light"]
    subjects = [_subject(name, *chosen) for name, chosen in whole.items()]
    subjects += [_subject(name, effects, plain) for name, effects in single.items()]
    times = interleave(subjects, num_views=FRAMES, num_rounds=ROUNDS)
    files = [[_recorded("", DEFAULT), _recorded(EFFECTS, DEFAULT)] for _ in range(5)]
    one, lossy = (Spread.of(1e3 * column) for column in np.transpose(files))
    text = f"""## Camera-pipeline speed

{FRAMES} frames of a flight at 2 cm/s through a generated colon, 30 frames per second, 320 × 320
pixels, color, depth, normal, label and instance; effects `{EFFECTS}`. Mean over the frames; median
of {ROUNDS} alternating rounds, in brackets p10 to p90; ratios are computed per round. All subjects
reuse freed memory. *Plain* is direct light without shadows and effects.

{table(HEAD, list(_rows(times, list(whole))))}

Each effect by itself at severity 2 (a Bayer filter RGGB), against the plain frame; all include the
cost of linear light and its 8-bit encoding:

{table(ALONE, [_more(name, times) for name in single])}

The same flight recorded into files by default ({_light(DEFAULT)}), {RECORDED} frames, median of
{len(files)}: without effects {_shown(one, 1)} ms per frame, with every effect {_shown(lossy, 1)}
ms.
"""
    write_section(args.out, Path(__file__), text)


def _light(settings: RenderSettings) -> str:
    return next(name for name, light in LIGHTS.items() if light == settings)


def _scenario(effects: str, light: RenderSettings, frames: int) -> Scenario:
    motion = FlyThrough(start=0.4, speed=0.02)
    scenario = Scenario(motion=motion, frames=frames, fps=30.0, render=light)
    return replace(scenario, effects=parse_effects(effects or "none,ae=settled"))


def _recorded(effects: str, light: RenderSettings) -> float:
    """Time per frame of a recording after its set-up [s]."""
    whole: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        scenario = _scenario(effects, light, RECORDED)
        record(scenario, folder, progress=lambda *_: whole.append(time.perf_counter()))
    return (whole[-1] - whole[0]) / (len(whole) - 1)


def _subject(name: str, effects: str, light: RenderSettings) -> Subject:
    """Pipeline that renders the images of a scenario."""
    resolved = resolve(_scenario(effects, light, FRAMES))
    scenario = resolved.scenario
    model, motion = build(resolved)
    cameras = CapsuleCameras(
        Renderer(model, scenario.render),
        scenario.effects,
        fps=resolved.fps,
        seed=scenario.seed,
        channels=scenario.channels,
    )
    steps = list(motion.steps())

    def frame(view: int) -> object:
        step = replace(steps[view])  # a new step without cached results
        cameras.expose(step)
        return cameras.capture(step)

    return Subject(name, frame)


def _rows(times: dict[str, Times], names: list[str]) -> Iterator[tuple[str, ...]]:
    plain = times["direct light"]
    for name in names:
        own, alike = times[name], times[name.removeprefix(f"{EVERY}, ")]
        wall, claims = Spread.of(1e3 * own.wall), ""
        over = ratio(own, plain)
        if name == f"{EVERY}, radiosity":
            rate = "yes" if wall.median <= 1e3 / 45.0 else "NO"
            claims = f"≥ 45: {rate}; ≤ 2 times plain: {'yes' if over.median <= 2.0 else 'NO'}"
        yield (
            name,
            _shown(wall, 1),
            f"{1e3 / wall.median:.0f}",
            _shown(Spread.of(1e3 * own.cpu), 1),
            _shown(over, 2),
            _shown(ratio(own, alike), 2) if alike is not own else "",
            claims,
        )


def _more(name: str, times: dict[str, Times]) -> tuple[str, ...]:
    plain, own = times["direct light"], times[name]
    wall, cpu = Spread.of(1e3 * (own.wall - plain.wall)), Spread.of(1e3 * (own.cpu - plain.cpu))
    return name, _shown(wall, 1), _shown(cpu, 1), _shown(ratio(own, plain), 2)


def _shown(spread: Spread, digits: int) -> str:
    median, low, high = (f"{x:.{digits}f}" for x in (spread.median, spread.p10, spread.p90))
    return f"{median} ({low} to {high})"


if __name__ == "__main__":
    main()
