"""Process measured by `vrcaps bench record`: records, then times each stage alone.

    python -m vrcaps.cli.benchmarks.recording_process FOLDER FRAMES SUBJECT

SUBJECT is one of `SUBJECTS`. Prints JSON: times in seconds, memory in GB.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.render.channels import Frame
    from vrcaps.scenario.scenario import Scenario

SUBJECTS = ("default", "quick light", "collapsed", "collapsed, empty")
"""Recordings along a whole colon, by default and with direct light without shadows; and at the
default speed in a small bowel whose wall is closed around the capsule, with contents by default and
without."""

_MAX_STAGE_FRAMES = 60


def main(folder: Path, num_frames: int, subject: str) -> dict[str, Any]:
    """Record into a folder and return measurements.

    Args:
        folder: An empty folder.
        num_frames: Frames to record.
        subject: One of `SUBJECTS`.
    """
    started = time.perf_counter()
    from vrcaps.recording.recorder import record

    scenario = _scenario(num_frames, subject)
    done: list[tuple[int, float]] = []

    def progress(num_done: int, total: int) -> None:
        if num_done and (not done or num_done > done[-1][0]):
            done.append((num_done, time.perf_counter()))

    episode = record(scenario, folder / "episode", progress=progress)
    ended = time.perf_counter()
    (num_first, first), (num_last, last) = done[0], done[-1]
    images = [path for path in episode.glob("*/*/*") if path.is_file()]
    return {
        "rate": (num_last - num_first) / (last - first),
        "set_up": first - started,
        "frames": last - first,
        "finish": ended - last,
        "peak_gb": peak_memory_gb(),
        "bytes": sum(path.stat().st_size for path in images),
        **_stages(scenario, folder),
    }


def _scenario(num_frames: int, subject: str) -> Scenario:
    from vrcaps.motion.fly_through import FlyThrough
    from vrcaps.render.settings import RenderSettings
    from vrcaps.scenario.scenario import OrganGenerated, Scenario

    if subject in ("collapsed", "collapsed, empty"):
        organ = OrganGenerated("small-bowel", distension="collapsed")
        return Scenario(frames=num_frames, organ=organ, variation=subject == "collapsed")
    scenario = Scenario(frames=num_frames, motion=FlyThrough(whole=True))
    if subject == "quick light":
        return replace(scenario, render=RenderSettings(light="direct", shadows=False))
    return scenario


def peak_memory_gb() -> float | None:
    """Peak memory of this process [GB = 1e9 bytes], or None if it is not available."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1.0 if sys.platform == "darwin" else 1024.0) / 1e9


def _stages(scenario: Scenario, folder: Path) -> dict[str, Any]:
    """Camera, wall, and the time of each stage of a frame in isolation [s]."""
    from vrcaps.core.files import write_bytes
    from vrcaps.recording.frame_files import write_images
    from vrcaps.render.channels import CHANNELS as DECLARED
    from vrcaps.render.renderer import Renderer
    from vrcaps.scenario.build import build, resolve

    resolved = resolve(scenario)
    channels, light = resolved.channels, scenario.render
    model, motion = build(resolved)
    steps, states = motion.steps(), {}
    camera, renderer = model.device.cameras[0], Renderer(model, scenario.render)
    frames = range(min(scenario.frames, _MAX_STAGE_FRAMES))
    rendered: dict[int, Frame] = {}
    stored: dict[int, list[tuple[Path, NDArray]]] = {}
    files: dict[Path, bytes] = {}
    reused: list[Frame | None] = [None]

    def move(i: int) -> None:
        states[i] = next(steps).state

    def render(i: int) -> None:
        rendered[i] = renderer.render(states[i], camera, channels=channels)

    def render_again(i: int) -> None:
        state = states[i]
        reused[0] = renderer.render(state, camera, channels=channels, out=reused[0])

    def store(i: int) -> None:
        stored[i] = [
            (folder / f"{i}-{name}.png", DECLARED[name].encoding.encode(getattr(rendered[i], name)))
            for name in channels
        ]

    def write(i: int) -> None:
        write_images(stored[i])

    def rewrite(i: int) -> None:
        for path, _ in stored[i]:
            write_bytes(path, files[path])

    stages = {
        "pose, first frame": {**_timed(move, frames[:1]), "note": "course of a closed lumen"},
        "pose": {**_timed(move, frames[1:]), "note": "and the wall around the capsule"},
        "render, first frame": {**_timed(render, frames[:1]), "note": "form factors of its wall"},
        "render": {**_timed(render, frames[1:]), "note": "into new arrays, as the recorder does"},
        "render, again": {**_timed(render_again, frames), "note": "the same frames, arrays reused"},
        "to stored numbers": {**_timed(store, frames), "note": "16-bit steps, in the core"},
        "PNG": {**_timed(write, frames), "note": "encoded and written, in the core"},
    }
    files.update((path, path.read_bytes()) for items in stored.values() for path, _ in items)
    stages["of it, files"] = {**_timed(rewrite, frames), "note": "the same bytes written again"}
    return {
        "camera": f"{model.device.title} ({camera.width} × {camera.height})",
        "num_triangles": len(model.organ.faces),
        "channels": ", ".join(channels),
        "light": light.light + (", shadows" if light.shadows else ", no shadows"),
        "stages": stages,
    }


def _timed(stage: Callable[[int], None], frames: range) -> dict[str, float]:
    """Mean wall-clock and CPU time of a stage [s]."""
    cpu, wall = time.process_time(), time.perf_counter()
    for i in frames:
        stage(i)
    return {
        "wall": (time.perf_counter() - wall) / len(frames),
        "cpu": (time.process_time() - cpu) / len(frames),
    }


if __name__ == "__main__":
    given = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    sys.stdout.write(json.dumps(main(*given)))
