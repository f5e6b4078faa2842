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
from vrcaps.cli.benchmarks.recording_process import SUBJECTS
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
    """Record each subject several times in turns, each in a separate process and folder."""
    results: dict[str, list[dict[str, Any]]] = {subject: [] for subject in SUBJECTS}
    with progress_bar("recording") as advance:
        for number in range(num_runs):
            for k, subject in enumerate(SUBJECTS):
                advance(number * len(SUBJECTS) + k, num_runs * len(SUBJECTS))
                results[subject].append(_recorded(num_frames, subject))
    runs, quick_runs, collapsed_runs, empty_runs = results.values()
    return Report(
        title="Recording speed",
        command="vrcaps bench record",
        setting=_setting(results, num_frames),
        claims=(
            replace(claims.TO_DISK, measured=_spread(runs, "rate")),
            replace(claims.QUICK_TO_DISK, measured=_spread(quick_runs, "rate")),
            replace(claims.COLLAPSED_TO_DISK, measured=_spread(collapsed_runs, "rate")),
            replace(claims.MEMORY, measured=_spread(runs, "peak_gb"))
            if runs[0]["peak_gb"] is not None
            else replace(claims.MEMORY, reason="this system does not report it"),
        ),
        tables=(
            _rates(results),
            _stages(runs, "Time per stage of a frame"),
            _stages(quick_runs, "Time per stage with direct light and no shadows"),
            _stages(collapsed_runs, "Time per stage in a collapsed small bowel"),
            _stages(empty_runs, "Time per stage in a collapsed small bowel without contents"),
            _whole(runs),
        ),
        machine=machine_facts(),
    )


def _setting(results: dict[str, list[dict[str, Any]]], num_frames: int) -> str:
    """Description of the recordings."""
    runs, _, collapsed, _ = results.values()
    first, size = runs[0], np.mean([run["bytes"] for run in runs])
    return (
        f"The recording default, `vrcaps record`: {num_frames} frames of {first['camera']} in the "
        f"generated colon of {first['num_triangles']} triangles, {first['light']}; "
        f"{first['channels']}, preview included, {size / num_frames / 1e3:.0f} kB a frame; and "
        f"the same in a small bowel of {collapsed[0]['num_triangles']} triangles, closed around "
        f"the capsule, with contents by default or none. {len(runs)} runs in turns, each in a "
        "fresh process and a temporary folder: along the whole colon, and at the default speed in "
        "the small bowel. The rate is from the first whole frame to the last. The stages below "
        "are then run one at a time over the same frames; in the recording they overlap."
    )


def _recorded(num_frames: int, subject: str) -> dict[str, Any]:
    """Results of a recording in a separate process.

    Raises:
        InputError: If it fails.
    """
    with scratch_folder() as folder:
        module = "vrcaps.cli.benchmarks.recording_process"
        command = [sys.executable, "-m", module, str(folder), str(num_frames), subject]
        answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode:
        last = (answer.stderr.strip() or "no message").splitlines()[-1]
        raise InputError(f"The recording to be measured failed: {last}")
    return json.loads(answer.stdout)


def _spread(runs: list[dict[str, Any]], key: str) -> Spread:
    return Spread.of(np.array([run[key] for run in runs]))


def _rates(results: dict[str, list[dict[str, Any]]]) -> Table:
    notes = (
        "colon, all by default",
        "colon, no shadows",
        "small bowel, contents by default",
        "small bowel, nothing drawn by prevalence",
    )
    rows = (
        Row(subject, (_spread(runs, "rate"),), note)
        for (subject, runs), note in zip(results.items(), notes, strict=True)
    )
    return Table("Recorded frames", ("per second",), tuple(rows))


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
