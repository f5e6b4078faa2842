"""`vrcaps bench render`: rendering speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.cli.benchmarks.report import Report, check_out, machine_facts, show_report
from vrcaps.cli.benchmarks.stage import FULL, QUICK, Extent, make_organ, make_stage
from vrcaps.cli.benchmarks.studies import STUDIES
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import UnknownNameError
from vrcaps.render.renderer import DEFAULT_CHANNELS

if TYPE_CHECKING:
    from vrcaps.cli.benchmarks.stage import Stage

_SEED = 0


def run(
    *,
    out: Path | None = None,
    quick: bool = False,
    only: Sequence[str] = (),
) -> Report:
    """Measure, print, and write Markdown.

    Args:
        out: Markdown file to write; None writes nothing.
        quick: Measure little; the values are meaningless.
        only: Names of `STUDIES`; by default all.

    Raises:
        UnknownNameError: If there is no such study.
        InputError: If `out` is not a Markdown file.
    """
    for name in only:
        if name not in STUDIES:
            raise UnknownNameError("study", name, STUDIES)
    check_out(out)
    report = measure(QUICK if quick else FULL, only=only or tuple(STUDIES))
    show_report(report, out, console)
    return report


def measure(extent: Extent, *, only: Sequence[str]) -> Report:
    """Run studies one after the other, each in its own rounds."""
    with console.status("generating the colon"):
        organ = make_organ(extent.num_triangles, seed=_SEED)
    stage = make_stage(organ, num_views=extent.num_views)
    studies = []
    for name in only:
        with progress_bar(name) as advance:
            studies.append(STUDIES[name](stage, extent, _counter(advance, extent.num_rounds + 1)))
    is_whole = tuple(only) == tuple(STUDIES)
    return Report(
        title="Rendering speed" if is_whole else f"Rendering speed: {', '.join(only)}",
        command="vrcaps bench render" + ("" if is_whole else f" --only {' '.join(only)}"),
        setting=setting(stage, extent),
        claims=tuple(claim for study in studies for claim in study.claims),
        tables=tuple(study.table for study in studies),
        machine=machine_facts(),
    )


def _counter(advance: Callable[[int, int], None], total: int) -> Callable[[], None]:
    done = iter(range(1, total + 1))
    return lambda: advance(next(done), total)


def setting(stage: Stage, extent: Extent) -> str:
    """Description of the measurement setup."""
    camera = stage.camera
    return (
        f"A generated colon of {stage.num_triangles} triangles, textured and wet; "
        f"{camera.width} × {camera.height} pixels, {len(camera.leds)} LEDs; the camera on the "
        f"centerline in {extent.num_views} views along the whole colon. Subjects take turns in "
        f"one process: {extent.num_rounds} rounds, in each one frame of every view after one "
        "that is not timed. Ratios are made round by round. Times are on the clock, and in "
        "processor time of all threads together, which other programs disturb less. A complete "
        f"frame contains {', '.join(DEFAULT_CHANNELS)}."
    )
