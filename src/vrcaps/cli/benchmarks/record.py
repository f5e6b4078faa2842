"""`vrcaps bench record`: speed of recording labeled frames to disk."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.cli.benchmarks import claims
from vrcaps.cli.benchmarks.report import (
    Report,
    Row,
    Spread,
    Table,
    check_out,
    machine_facts,
    show_report,
)
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError
from vrcaps.core.files import scratch_folder


def run(*, out: Path | None = None, quick: bool = False) -> Report:
    """Measure, print, and write Markdown.

    Args:
        out: Markdown file to write; None writes nothing.
        quick: Measure little; the values are meaningless.

    Raises:
        InputError: If `out` is not a Markdown file, or a recording fails.
    """
    check_out(out)
    report = measure(num_frames=12 if quick else 300, num_runs=1 if quick else 5)
    show_report(report, out, console)
    return report


def measure(*, num_frames: int, num_runs: int) -> Report:
    """Record the same scenario several times, each in a separate process and folder."""
    with progress_bar("recording") as advance:
        runs, quick_runs = [], []
        for number in range(num_runs):
            advance(number, num_runs)
            runs.append(_recorded(num_frames))
            quick_runs.append(_recorded(num_frames, "quick"))
    first, size = runs[0], np.mean([run["bytes"] for run in runs])
    setting = (
        f"The recording default, `vrcaps record`: {num_frames} frames of {first['camera']} in the "
        f"generated colon of {first['num_triangles']} triangles, {first['light']}; "
        f"{first['channels']}, preview included, {size / num_frames / 1e3:.0f} kB a frame. "
        f"{num_runs} runs, each in a fresh process and a temporary folder; the rate is from the "
        "first whole frame to the last. The stages below are then run one at a time over the "
        "same frames; in the recording they overlap."
    )
    measured = (
        replace(claims.TO_DISK, measured=_spread(runs, "rate")),
        replace(claims.QUICK_TO_DISK, measured=_spread(quick_runs, "rate")),
        replace(claims.MEMORY, measured=_spread(runs, "peak_gb"))
        if first["peak_gb"] is not None
        else replace(claims.MEMORY, reason="this system does not report it"),
    )
    return Report(
        title="Recording speed",
        command="vrcaps bench record",
        setting=setting,
        claims=measured,
        tables=(
            _stages(runs, "Time per stage of a frame"),
            _stages(quick_runs, "Time per stage with direct light and no shadows"),
            _whole(runs),
        ),
        machine=machine_facts(),
    )


def _recorded(num_frames: int, *words: str) -> dict[str, Any]:
    """Results of a recording in a separate process; `words` are further arguments to it.

    Raises:
        InputError: If it fails.
    """
    with scratch_folder() as folder:
        module = "vrcaps.cli.benchmarks.recording_process"
        command = [sys.executable, "-m", module, str(folder), str(num_frames), *words]
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode:
        last = (answer.stderr.strip() or "no message").splitlines()[-1]
        raise InputError(f"The recording to be measured failed: {last}")
    return json.loads(answer.stdout)


def _spread(runs: list[dict[str, Any]], key: str) -> Spread:
    return Spread.of(np.array([run[key] for run in runs]))


def _stages(runs: list[dict[str, Any]], title: str) -> Table:
    rows = [
        Row(
            name,
            tuple(
                Spread.of(np.array([run["stages"][name][kind] for run in runs])).scaled(1e3)
                for kind in ("wall", "cpu")
            ),
            first["note"],
        )
        for name, first in runs[0]["stages"].items()
    ]
    return Table(title, ("ms", "ms of processors"), tuple(rows))


def _whole(runs: list[dict[str, Any]]) -> Table:
    notes = {
        "set_up": "imports, organ from the cache or generated, motion, organ.glb",
        "frames": "all images and the preview",
        "finish": "contact sheet",
    }
    rows = tuple(Row(name.replace("_", " "), (_spread(runs, name),), notes[name]) for name in notes)
    return Table("Time per stage of a run", ("s",), rows)
