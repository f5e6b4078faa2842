"""`vrcaps bench render`: how fast images are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.cli.benchmarks.extent import FULL, QUICK, Extent
from vrcaps.cli.benchmarks.peers import PACKAGES, package_versions
from vrcaps.cli.benchmarks.report import Report, check_out, machine_facts, show_report
from vrcaps.cli.benchmarks.stage import make_organ, make_stage
from vrcaps.cli.benchmarks.studies import STUDIES
from vrcaps.cli.console import console, progress_bar
from vrcaps.errors import UnknownNameError
from vrcaps.render.renderer import DEFAULT_CHANNELS

if TYPE_CHECKING:
    from vrcaps.cli.benchmarks.stage import Stage

_SEED = 0


def run(
    *,
    out: Path | None = None,
    quick: bool = False,
    only: Sequence[str] = (),
    peers: Sequence[str] | None = None,
) -> Report:
    """Measure, print, and write Markdown and JSON.

    Args:
        out: Markdown file to write; None writes nothing.
        quick: Measure little; the figures mean nothing.
        only: Names of `STUDIES`; all by default.
        peers: Other renderers of `PACKAGES` to measure beside ours; all by default.

    Raises:
        UnknownNameError: If there is no such study or peer.
        InputError: If `out` is no Markdown file.
    """
    for noun, names, known in (("study", only, STUDIES), ("peer", peers or (), PACKAGES)):
        for name in names:
            if name not in known:
                raise UnknownNameError(noun, name, known)
    check_out(out)
    extent = QUICK if quick else FULL
    if peers is not None:
        extent = replace(extent, peers=tuple(peers))
    report = measure(extent, only=only or tuple(STUDIES))
    show_report(report, out, console)
    return report


def measure(extent: Extent, *, only: Sequence[str]) -> Report:
    """Run studies one after the other, each in rounds of its own."""
    with console.status("generating the colon"):
        organ = make_organ(extent.num_triangles, seed=_SEED)
    stage = make_stage(organ, num_views=extent.num_views)
    found = []
    for name in only:
        with progress_bar(name) as advance:
            found.append(STUDIES[name](stage, extent, _counter(advance, extent.num_rounds + 1)))
    is_whole = tuple(only) == tuple(STUDIES)
    return Report(
        name="render" if is_whole else f"render-{'-'.join(only)}",
        command="vrcaps bench render" + ("" if is_whole else f" --only {' '.join(only)}"),
        setting=_setting(stage, extent),
        claims=tuple(claim for study in found for claim in study.claims),
        tables=tuple(study.table for study in found),
        skipped={name: why for study in found for name, why in study.skipped.items()},
        machine=machine_facts() | {"peers": _peers()},
    )


def _counter(advance: Callable[[int, int], None], total: int) -> Callable[[], None]:
    done = iter(range(1, total + 1))
    return lambda: advance(next(done), total)


def _setting(stage: Stage, extent: Extent) -> str:
    camera = stage.camera
    return (
        f"A generated colon of {stage.num_triangles} triangles, textured and wet; "
        f"{camera.width} × {camera.height} pixels, {len(camera.leds)} LEDs; the camera on the "
        f"centreline in {extent.num_views} views along the whole colon. Subjects take turns in "
        f"one process: {extent.num_rounds} rounds, in each one frame of every view after one "
        "that is not timed. Ratios are made round by round. Times are on the clock, and in "
        "processor time of all threads together, which other programs disturb less. A complete "
        f"frame holds {', '.join(DEFAULT_CHANNELS)}."
    )


def _peers() -> str:
    return ", ".join(f"{name} {number}" for name, number in package_versions().items())
