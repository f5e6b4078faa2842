"""Claim: a complete labeled frame takes less time than a part of it takes in peers.

At most 0.40 of Embree's time for the same rays unshaded (embreex as trimesh and its users call it:
`EmbreeScene.run(origins, directions, output=1)`, one thread; the table also states ours on one
thread); half of Mitsuba's direct light and AOV in its fastest known set-up, compiled by LLVM, and a
fourth of the same by `mi.render`; a sixth of MuJoCo's rgb, depth and segmentation. Sources:
https://github.com/trimesh/embreex, https://www.mitsuba-renderer.org, https://mujoco.org

    python -m benchmarks.speed.compare_peers [--quick] [--only embree] [--out PAGE.md]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro

from benchmarks.common.sections import write_section
from benchmarks.speed.peers import PACKAGES, embree, find_peers, mitsuba, mujoco, package_versions
from vrcaps.cli.benchmarks.render import COLUMNS, COMPLETE, drawn, row, setting
from vrcaps.cli.benchmarks.report import (
    PAGE_TITLE,
    Claim,
    Report,
    Subject,
    Table,
    Times,
    check_out,
    interleave,
    machine_facts,
    ratio,
    show_report,
    to_markdown,
)
from vrcaps.cli.benchmarks.stage import FULL, QUICK, Extent, Stage, make_organ, make_stage
from vrcaps.cli.console import console
from vrcaps.core.errors import UnknownNameError
from vrcaps.render.settings import RenderSettings

EMBREE = Claim(
    text="complete labeled frame on all threads over Embree's bare primary rays on one",
    sense="≤",
    limit=0.40,
    unit="",
    reference="embreex's own call, single rays",
)
MITSUBA = Claim(
    text="Mitsuba's direct light + AOV, the fastest set-up found (its integrator on our ray table, "
    "no film, drjit.freeze), over a complete labeled frame without shadows; ours shades six LEDs "
    "and relief, Mitsuba one LED a pixel with its shadow and no relief",
    sense="≥",
    limit=2.0,
    unit="",
    reference="Mitsuba 3.9 LLVM: 8.9 ms",
)
MITSUBA_RENDER = Claim(
    text="the same by mi.render, as Mitsuba's users run it, over a complete labeled frame",
    sense="≥",
    limit=4.0,
    unit="",
    reference="Mitsuba 3.9 LLVM: 29.5 ms",
)
MUJOCO = Claim(
    text="MuJoCo's rgb + depth + segmentation over a complete labeled frame",
    sense="≥",
    limit=6.0,
    unit="",
    reference="MuJoCo 4.0 EGL in software, 52 ms",
)

_JUDGED = (
    (EMBREE, embree.PRIMARY_RAYS, "embree"),
    (MITSUBA, mitsuba.BARE, "mitsuba"),
    (MITSUBA_RENDER, mitsuba.RENDER, "mitsuba"),
    (MUJOCO, mujoco.ALL, "mujoco"),
)


def measure(stage: Stage, extent: Extent, names: tuple[str, ...]) -> Report:
    """Time a complete frame and the peers' frames alternately in this process."""
    peers, skipped = find_peers(stage, names)
    shadowed = RenderSettings(light="direct", shadows=True)
    subjects = [
        Subject(COMPLETE, drawn(stage), "color and all labels, six LEDs, relief, no shadows"),
        Subject(
            f"{COMPLETE}, shadows", drawn(stage, settings=shadowed), "a shadow ray to each LED"
        ),
        *peers,
    ]
    times = interleave(subjects, num_views=extent.num_views, num_rounds=extent.num_rounds)
    ours = times[COMPLETE]

    def judged(claim: Claim, peer: str, package: str) -> Claim:
        if peer not in times:
            return replace(claim, reason=skipped.get(package, "not asked for"))
        pair = (ours, times[peer]) if claim.sense == "≤" else (times[peer], ours)
        return replace(claim, measured=ratio(*pair))

    rows = tuple(row(s, times[s.name], ratio(times[s.name], ours)) for s in subjects)
    more = () if "embree" not in names or "embree" in skipped else (one_thread(extent),)
    versions = ", ".join(f"{name} {number}" for name, number in package_versions().items())
    return Report(
        title="Rendering speed compared with other renderers",
        command="python -m benchmarks.speed.compare_peers",
        setting=setting(stage, extent),
        claims=tuple(judged(*entry) for entry in _JUDGED),
        tables=(
            Table("One frame compared with other renderers", (*COLUMNS, "times ours"), rows),
            *more,
        ),
        skipped=skipped,
        machine=machine_facts() | {"peers": versions},
    )


def one_thread(extent: Extent) -> Table:
    """Ours and Embree in turns in a process whose threads are one."""
    environment = os.environ | {"RAYON_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks.speed.compare_peers", "--single"]
    command += ["--quick"] if extent is QUICK else []
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    times = {name: Times(*np.array(pair)) for name, pair in json.loads(answer.stdout).items()}
    note = {COMPLETE: "the same frame as above", embree.PRIMARY_RAYS: "the same rays as above"}
    rows = tuple(
        row(Subject(f"{name}, alone", int, note[name]), own, ratio(own, times[COMPLETE]))
        for name, own in times.items()
    )
    return Table("On one thread", (*COLUMNS, "times ours"), rows)


def measure_single(stage: Stage, extent: Extent) -> str:
    """Times of ours and Embree as JSON."""
    subjects = [Subject(COMPLETE, drawn(stage)), *embree.subjects(stage)]
    times = interleave(subjects, num_views=extent.num_views, num_rounds=extent.num_rounds)
    return json.dumps({name: [t.wall.tolist(), t.cpu.tolist()] for name, t in times.items()})


def main(
    *,
    quick: bool = False,
    out: Path | None = None,
    only: tuple[str, ...] = tuple(PACKAGES),
    single: bool = False,
) -> None:
    """Measure and print.

    Args:
        quick: Only try whether it runs.
        out: Markdown page to write a section of.
        only: Peers to measure.
        single: Only print times of ours and Embree, as JSON.
    """
    check_out(out)
    for name in only:
        if name not in PACKAGES:
            raise UnknownNameError("peer", name, PACKAGES)
    extent = QUICK if quick else FULL
    stage = make_stage(make_organ(extent.num_triangles, seed=0), num_views=extent.num_views)
    if single:
        print(measure_single(stage, extent))
        return
    report = measure(stage, extent, only)
    show_report(report, None, console)
    if out is not None:
        command, text = report.command, to_markdown(report)
        name = command.removeprefix("python -m ")
        write_section(out, name, text, command=command, title=PAGE_TITLE)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
