"""Run the recorder with a progress bar and print a summary; used by `record` and `demo`."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.cli.console import console, progress_bars
from vrcaps.cli.lesions import lesion_lines
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from vrcaps.scenario.scenario import Scenario


def run_recording(scenario: Scenario, out: Path, *, threads: int | None = None) -> None:
    """Record a scenario and print a summary.

    Args:
        scenario: Scenario to record.
        out: Folder of the episode.
        threads: Number of threads; None leaves it to the core.

    Raises:
        InputError: If the number of threads or the scenario is invalid.
    """
    use_threads(threads)
    from vrcaps.recording.recorder import record

    started = time.perf_counter()
    times: list[float] = []
    with progress_bars("recording", "simulating") as (advance, simulated):

        def progress(num_done: int, total: int) -> None:
            times.append(time.perf_counter())
            advance(num_done, total)

        record(scenario, out, progress=progress, simulated=simulated)
    _summarize(out, times, time.perf_counter() - started)


def use_threads(threads: int | None) -> None:
    """Limit the threads of core and denoiser; only before the first parallel work.

    Raises:
        InputError: If the number is not positive.
    """
    if threads is None:
        return
    if threads < 1:
        raise InputError(f"--threads is {threads}. Allowed: 1 or more.")
    os.environ["RAYON_NUM_THREADS"] = os.environ["OIDN_NUM_THREADS"] = str(threads)


def _summarize(out: Path, times: list[float], seconds: float) -> None:
    """Print the path of the episode, its contents, the speed, and files to open."""
    from vrcaps.recording.episode import read_episode

    episode = read_episode(out)
    cameras = ", ".join(camera.name for camera in episode.cameras)
    console.print(
        f"Recorded {len(episode)} frames of {cameras} into {out} in {seconds:.1f} s", end=""
    )
    if len(times) > 1 and times[-1] > times[0]:
        rate = (len(times) - 1) / (times[-1] - times[0])
        console.print(f" ({rate:.0f} frames per second once set up)", end="")
    console.print(".")
    console.print(f"Channels: {', '.join(episode.channels)}.")
    organ = episode.head["organ"]
    for line in lesion_lines(organ.get("lesions", []), organ["centerline_length_m"]):
        console.print(f"Lesion {line}.")
    for line in lesion_lines(organ.get("clean_twin_of", []), organ["centerline_length_m"]):
        console.print(f"Without lesion {line}.")
    for note in episode.head.get("motion_notes", []):
        console.print(f"Note: {note}")
    pictures = [out / name for name in ("sheet.png", "preview.mp4") if (out / name).exists()]
    console.print(f"Look at {' and '.join(str(path) for path in pictures)}.")
    console.print(f"Check it with: vrcaps check {out}")
