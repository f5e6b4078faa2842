"""Claim: a complete labeled frame costs less than what peers need for a part of it.

At most 0.40 of Embree's time for the same rays unshaded (embreex as trimesh and its users call it:
`EmbreeScene.run(origins, directions, output=1)`, one thread); a fourth of Mitsuba's direct light
and AOV by `mi.render`, compiled by LLVM; a sixth of MuJoCo's rgb, depth and segmentation.
Sources: https://github.com/trimesh/embreex, https://www.mitsuba-renderer.org, https://mujoco.org

    python benchmarks/speed_peers.py [--quick] [--only embree] [--out docs/benchmarks.md]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import tyro

from peers import PACKAGES, embree, find_peers, mitsuba, mujoco, package_versions
from vrcaps.cli.benchmarks.extent import FULL, QUICK, Extent
from vrcaps.cli.benchmarks.render import setting
from vrcaps.cli.benchmarks.report import Claim, Report, Table, check_out, machine_facts, show_report
from vrcaps.cli.benchmarks.stage import Stage, make_organ, make_stage
from vrcaps.cli.benchmarks.studies import COLUMNS, COMPLETE, drawn, row
from vrcaps.cli.benchmarks.timing import Subject, interleave, ratio
from vrcaps.cli.console import console
from vrcaps.errors import UnknownNameError

EMBREE = Claim(
    text="complete labeled frame over Embree's bare primary rays for the same pixels",
    sense="≤",
    limit=0.40,
    unit="",
    reference="embreex's own call, single rays",
)
MITSUBA = Claim(
    text="Mitsuba's direct light + AOV (mi.render) over a complete labeled frame",
    sense="≥",
    limit=4.0,
    unit="",
    reference="Mitsuba 3.9 LLVM, its fastest variant, as its users run it: 29.5 ms",
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
    (MITSUBA, mitsuba.RENDER, "mitsuba"),
    (MUJOCO, mujoco.ALL, "mujoco"),
)


def measure(stage: Stage, extent: Extent, names: tuple[str, ...]) -> Report:
    """Time a complete frame and the peers' frames in turns in this process."""
    peers, skipped = find_peers(stage, names)
    subjects = [Subject(COMPLETE, drawn(stage), "color and all labels"), *peers]
    times = interleave(subjects, num_views=extent.num_views, num_rounds=extent.num_rounds)
    ours = times[COMPLETE]

    def judged(claim: Claim, peer: str, package: str) -> Claim:
        if peer not in times:
            return replace(claim, reason=skipped.get(package, "not asked for"))
        pair = (ours, times[peer]) if claim.sense == "≤" else (times[peer], ours)
        return replace(claim, measured=ratio(*pair))

    rows = tuple(row(s, times[s.name], ratio(times[s.name], ours)) for s in subjects)
    versions = ", ".join(f"{name} {number}" for name, number in package_versions().items())
    return Report(
        name="peers",
        command="python benchmarks/speed_peers.py",
        setting=setting(stage, extent),
        claims=tuple(judged(*entry) for entry in _JUDGED),
        tables=(Table("One frame beside peers", (*COLUMNS, "times ours"), rows),),
        skipped=skipped,
        machine=machine_facts() | {"peers": versions},
    )


def main(
    *, quick: bool = False, out: Path | None = None, only: tuple[str, ...] = tuple(PACKAGES)
) -> None:
    """Measure and print.

    Args:
        quick: Only try whether it runs.
        out: Markdown file to write, with a folder of JSON beside it.
        only: Peers to measure.
    """
    check_out(out)
    for name in only:
        if name not in PACKAGES:
            raise UnknownNameError("peer", name, PACKAGES)
    extent = QUICK if quick else FULL
    stage = make_stage(make_organ(extent.num_triangles, seed=0), num_views=extent.num_views)
    show_report(measure(stage, extent, only), out, console)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
