"""`vrcaps bench render`: rendering speed, by comparisons that each create one table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.cli.benchmarks import claims
from vrcaps.cli.benchmarks.report import (
    Claim,
    Report,
    Row,
    Spread,
    Subject,
    Table,
    Times,
    check_out,
    interleave,
    machine_facts,
    ratio,
    show_report,
)
from vrcaps.cli.benchmarks.stage import (
    FULL,
    QUICK,
    Extent,
    Stage,
    make_organ,
    make_stage,
    resized_camera,
    subdivide,
    with_moving_wall,
)
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import UnknownNameError
from vrcaps.core.processes import ProgressReport
from vrcaps.render.renderer import DEFAULT_CHANNELS, Renderer
from vrcaps.render.settings import RenderSettings

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera
    from vrcaps.render.channels import Frame

COMPLETE = "complete frame"
_MS = 1e3
COLUMNS = ("ms", "ms of processors")


@dataclass(frozen=True)
class Study:
    """Result of one comparison.

    Attributes:
        table: All timings.
        claims: Claims that it evaluates.
    """

    table: Table
    claims: tuple[Claim, ...] = ()


def drawn(
    stage: Stage,
    *,
    channels: Sequence[str] = DEFAULT_CHANNELS,
    cameras: Sequence[Camera] = (),
    settings: RenderSettings | None = None,
) -> Callable[[int], object]:
    """Function that renders a view into reused arrays, as a loop over frames would.

    Args:
        stage: Scene to render.
        channels: Channels to fill.
        cameras: Cameras to render one after the other; by default the stage's own.
        settings: Render settings; None is direct light without shadows.
    """
    renderer = Renderer(stage.model, settings or RenderSettings(light="direct", shadows=False))
    chosen = tuple(cameras) or (stage.camera,)
    outs: list[Frame | None] = [None] * len(chosen)

    def frame(view: int) -> object:
        for k, camera in enumerate(chosen):
            state = stage.states[view]
            outs[k] = renderer.render(state, camera, channels=channels, out=outs[k])
        return outs

    return frame


def _timed(
    subjects: Sequence[Subject], extent: Extent, progress: Callable[[], None]
) -> dict[str, Times]:
    return interleave(
        subjects, num_views=extent.num_views, num_rounds=extent.num_rounds, progress=progress
    )


def row(subject: Subject, times: Times, *more: Spread) -> Row:
    """Row of a table: wall-clock and CPU times, and further measures."""
    both = (Spread.of(times.wall).scaled(_MS), Spread.of(times.cpu).scaled(_MS))
    return Row(subject.name, (*both, *more), subject.note)


def frame(stage: Stage, extent: Extent, progress: Callable[[], None]) -> Study:
    """Time a complete frame, parts of it and extensions of it."""
    subjects = [
        Subject(COMPLETE, drawn(stage), "color and all labels, direct light without shadows"),
        Subject("ray distance only", drawn(stage, channels=("ray_distance",)), "nothing shaded"),
        Subject(
            f"{COMPLETE}, shadows",
            drawn(stage, settings=RenderSettings(light="direct", shadows=True)),
            "a shadow ray to each LED",
        ),
        *(
            Subject(
                f"{COMPLETE}, radiosity{', shadows' * shadows}",
                drawn(stage, settings=RenderSettings(light="radiosity", shadows=shadows)),
                "indirect light" + ", the default" * (RenderSettings().shadows == shadows),
            )
            for shadows in (False, True)
        ),
        Subject(
            f"{COMPLETE}, moving wall",
            drawn(with_moving_wall(stage)),
            "all vertices new in each frame, refit included",
        ),
    ]
    times = _timed(subjects, extent, progress)
    ours = times[COMPLETE]
    rows = tuple(row(s, times[s.name], ratio(times[s.name], ours)) for s in subjects)
    table = Table("One frame", (*COLUMNS, "times ours"), rows)
    return Study(table, (replace(claims.RATE, measured=Spread.of(1.0 / ours.wall)),))


def pixels(stage: Stage, extent: Extent, progress: Callable[[], None]) -> Study:
    """Time a complete frame at different image sizes, with the same ideal fisheye."""
    subjects = [
        Subject(
            f"{size} × {size}",
            drawn(stage, cameras=[resized_camera(stage.camera, size)]),
            "equidistant, 170° across",
        )
        for size in extent.sizes
    ]
    times = _timed(subjects, extent, progress)
    per_pixel = {
        subject.name: Times(times[subject.name].wall / size**2, times[subject.name].cpu / size**2)
        for subject, size in zip(subjects, extent.sizes, strict=True)
    }
    least = per_pixel[subjects[0].name]
    rows = tuple(
        row(
            s,
            times[s.name],
            Spread.of(per_pixel[s.name].wall).scaled(1e9),
            ratio(per_pixel[s.name], least),
        )
        for s in subjects
    )
    table = Table("Image size", (*COLUMNS, "ns per pixel", "against smallest"), rows)
    costs = [ratio(per_pixel[s.name], least) for s in subjects[1:]]
    worst = max(costs, key=lambda cost: cost.median)
    return Study(table, (replace(claims.PIXELS, measured=worst),))


def triangles(stage: Stage, extent: Extent, progress: Callable[[], None]) -> Study:
    """Time a complete frame of increasingly fine meshes of the same wall."""
    organ = stage.model.organ
    if extent.coarsest != extent.num_triangles:
        organ = make_organ(extent.coarsest, seed=organ.metadata["seed"])
    subjects = []
    for level in range(extent.num_subdivisions + 1):
        organ = subdivide(organ) if level else organ
        view = make_stage(organ, num_views=extent.num_views)
        note = "the one before, each triangle cut in four" if level else "as generated"
        subjects.append(Subject(f"{view.num_triangles} triangles", drawn(view), note))
    times = _timed(subjects, extent, progress)
    least = times[subjects[0].name]
    rows = tuple(row(s, times[s.name], ratio(times[s.name], least)) for s in subjects)
    return Study(Table("Triangles", (*COLUMNS, "against fewest"), rows))


def refit(stage: Stage, extent: Extent, progress: Callable[[], None]) -> Study:
    """Time the refit of the hierarchy after every vertex of a wall has moved."""
    from vrcaps.core.geometry import wall_of

    moving = with_moving_wall(stage)
    vertices = [np.ascontiguousarray(state.vertices_world, np.float64) for state in moving.states]
    faces = np.ascontiguousarray(stage.model.organ.faces, np.int64)
    wall = wall_of(vertices[0], faces)
    subjects = [
        Subject("refit", lambda view: wall.refit(vertices[view]), "with new vertex normals"),
        Subject(
            "build", lambda view: wall_of(vertices[view], faces), "from nothing, for comparison"
        ),
    ]
    times = _timed(subjects, extent, progress)
    share = 1e5 / stage.num_triangles
    rows = tuple(
        row(s, times[s.name], Spread.of(times[s.name].wall).scaled(_MS * share)) for s in subjects
    )
    table = Table("Refit of a moved wall", (*COLUMNS, "ms per 100,000 triangles"), rows)
    measured = Spread.of(times["refit"].wall).scaled(_MS * share)
    return Study(table, (replace(claims.REFIT, measured=measured),))


def heads(stage: Stage, extent: Extent, progress: Callable[[], None]) -> Study:
    """Time both heads of a capsule against one."""
    two = make_stage(stage.model.organ, "pillcam-colon2", num_views=extent.num_views)
    front, back = two.model.device.cameras
    subjects = [
        Subject("front head", drawn(two, cameras=[front]), two.model.device.title),
        Subject("back head", drawn(two, cameras=[back])),
        Subject("both heads", drawn(two, cameras=[front, back])),
    ]
    times = _timed(subjects, extent, progress)
    wall = 0.5 * (times["front head"].wall + times["back head"].wall)
    one = Times(wall, 0.5 * (times["front head"].cpu + times["back head"].cpu))
    rows = tuple(row(s, times[s.name], ratio(times[s.name], one)) for s in subjects)
    table = Table("Two heads", (*COLUMNS, "against the mean head"), rows)
    return Study(table, (replace(claims.HEADS, measured=ratio(times["both heads"], one)),))


STUDIES: dict[str, Callable[[Stage, Extent, Callable[[], None]], Study]] = {
    "frame": frame,
    "pixels": pixels,
    "triangles": triangles,
    "refit": refit,
    "heads": heads,
}
"""Comparisons by name, in the order of execution."""


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


def _counter(advance: ProgressReport, total: int) -> Callable[[], None]:
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
