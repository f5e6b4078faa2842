"""Claim: frames with every effect at severity 2 and radiosity come at 45 a second or more.

A flight at 2 cm/s through a generated colon, 320 x 320 pixels, color and four labels: the plain
frame, with radiosity, with lens and sensor, and with both; and each effect by itself. No
sensor of fewer pixels, so that all have the same size. First images only: of each frame the least
time of several rounds in turns, as whatever else the machine does only adds to it. Then recorded
into files, as `vrcaps record` does.

    python benchmarks/speed_effects.py
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

import vrcaps
from validation import PAGE, table, write_section
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.camera_pipeline.effects import SEVERITIES
from vrcaps.camera_pipeline.parse import parse_effects
from vrcaps.motion.step import Step
from vrcaps.recording.recorder import record
from vrcaps.render.renderer import Renderer
from vrcaps.scenario.build import build, resolve
from vrcaps.scenario.scenario import Scenario

FRAMES, RECORDED = 60, 200
ROUNDS = 15
EFFECTS = "all=2,resolution=0"
EVERY = "every effect at severity 2"
HEAD = ("frame", "time [ms]", "frames a second", "processor time [ms]", "times plain", "claimed")
ALONE = ("effect", "longer by [ms]", "processor time more [ms]")


def main() -> None:
    """Measure all in turns, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PAGE, help="Markdown page to write into")
    args = parser.parse_args()
    subjects = {
        "plain": _subject("", "direct"),
        "radiosity": _subject("", "radiosity"),
        EVERY: _subject(EFFECTS, "direct"),
        f"{EVERY}, radiosity": _subject(EFFECTS, "radiosity"),
    }
    whole = list(subjects)
    subjects |= {
        name: _subject(f"{name}=2", "direct") for name in SEVERITIES if name != "resolution"
    }
    subjects["bayer_filter"] = _subject("bayer=rggb", "direct")
    least = {name: np.full((FRAMES, 2), np.inf) for name in subjects}
    for index in range(-1, ROUNDS):  # the first round is not counted
        for name, (cameras, steps) in subjects.items():
            seconds = _round(cameras, steps)
            if index >= 0:
                least[name] = np.minimum(least[name], seconds)
    times = {name: frames.mean(axis=0) for name, frames in least.items()}
    rows = list(_rows({name: times[name] for name in whole}))
    alone = [_more(name, times) for name in times if name not in whole]
    files = np.median(
        [[_recorded("", "direct"), _recorded(EFFECTS, "radiosity")] for _ in "123"], 0
    )
    plain, lossy = files.tolist()
    text = f"""## Speed of lens and sensor

{FRAMES} frames of a flight at 2 cm/s through a generated colon, 30 a second, 320 × 320 pixels,
color, depth, normal, label and instance; effects `{EFFECTS}`. Of each frame the least time of
{ROUNDS} rounds in turns, as whatever else the machine does only adds to it; mean over the frames.

{table(HEAD, rows)}

Each effect by itself at severity 2 (a Bayer filter RGGB), against the plain frame; all include
what any first effect brings, linear light and 8 bits of it:

{table(ALONE, alone)}

The same flight recorded into files, {RECORDED} frames, median of 3: plain {1e3 * plain:.1f} ms a
frame ({1.0 / plain:.0f} a second), with every effect and radiosity {1e3 * lossy:.1f} ms
({1.0 / lossy:.0f} a second), {lossy / plain:.1f} times as long.

By `python benchmarks/speed_effects.py`.
"""
    write_section(args.out, "speed_effects.py", text)


def _scenario(effects: str, light: Literal["direct", "radiosity"], frames: int) -> Scenario:
    scenario = vrcaps.Scenario(
        motion=vrcaps.FlyThrough(start=0.4, speed=0.02),
        frames=frames,
        fps=30.0,
        render=vrcaps.RenderSettings(light=light),
    )
    return replace(scenario, effects=parse_effects(effects)) if effects else scenario


def _recorded(effects: str, light: Literal["direct", "radiosity"]) -> float:
    """Seconds a frame of a recording once set up."""
    whole: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        scenario = _scenario(effects, light, RECORDED)
        record(scenario, folder, progress=lambda *_: whole.append(time.perf_counter()))
    return (whole[-1] - whole[0]) / (len(whole) - 1)


def _subject(
    effects: str, light: Literal["direct", "radiosity"]
) -> tuple[CapsuleCameras, list[Step]]:
    """What makes the images of a scenario, and its frames."""
    scenario = resolve(_scenario(effects, light, FRAMES))
    model, motion = build(scenario)
    cameras = CapsuleCameras(
        Renderer(model, scenario.render),
        scenario.effects,
        fps=scenario.fps or 30.0,
        seed=scenario.seed,
        channels=scenario.channels,
    )
    return cameras, list(motion.steps())


def _round(cameras: CapsuleCameras, steps: list[Step]) -> np.ndarray:
    """Seconds of each frame on the clock, and of processors."""
    seconds = np.zeros((len(steps), 2))
    for index, step in enumerate(steps):
        begin = time.perf_counter(), time.process_time()
        cameras.expose(step)
        cameras.capture(step)
        seconds[index] = time.perf_counter() - begin[0], time.process_time() - begin[1]
    return seconds


def _rows(times: dict[str, np.ndarray]) -> Iterator[tuple[str, ...]]:
    plain = times["plain"][0]
    for name, (wall, processors) in times.items():
        claims = ""
        if name == list(times)[-1]:
            fast, lean = 1.0 / wall >= 45.0, wall <= 2.0 * plain
            claims = f"≥ 45: {_word(fast)}; ≤ 2 times plain: {_word(lean)}"
        cells = (f"{1e3 * wall:.1f}", f"{1.0 / wall:.0f}", f"{1e3 * processors:.1f}")
        yield (name, *cells, f"{wall / plain:.2f}", claims)


def _more(name: str, times: dict[str, np.ndarray]) -> tuple[str, str, str]:
    wall, processors = 1e3 * (times[name] - times["plain"])
    return name, f"{wall:.1f}", f"{processors:.1f}"


def _word(holds: bool) -> str:
    return "yes" if holds else "NO"


if __name__ == "__main__":
    main()
