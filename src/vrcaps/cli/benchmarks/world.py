"""`vrcaps bench world`: speed of the physics."""

from __future__ import annotations

import time
from collections.abc import Callable
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
    Table,
    check_out,
    machine_facts,
    show_report,
)
from vrcaps.cli.benchmarks.stage import FULL, QUICK, Stage, make_organ, make_stage
from vrcaps.cli.console import console
from vrcaps.core.units import MM
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.mechanics import SUBSTEP
from vrcaps.world.model import MovingWall
from vrcaps.world.world import World

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.render.channels import Frame

_SEED = 0
_NUM_ROUNDS = 200
_WARM = 5
_VIEWS = (2, 4, 6)
_REST = 1.0
_FRAME = 1.0 / 60.0
_COARSER = 2e-4
_FEM_STEP, _FEM_EDGE = 5e-3, 22.0 * MM
_MIN_DOF = 20_000


@dataclass(frozen=True)
class Timed:
    """Times of one call over its repetitions [s]."""

    wall: Float[np.ndarray, " n"]
    cpu: Float[np.ndarray, " n"]

    def row(self, name: str, note: str, scale: float) -> Row:
        """Both times in another unit."""
        return Row(name, tuple(Spread.of(t).scaled(scale) for t in (self.wall, self.cpu)), note)


def run(*, out: Path | None = None, quick: bool = False) -> Report:
    """Measure, print, and write Markdown.

    Args:
        out: Markdown file to write; None writes nothing.
        quick: Measure little; the values are meaningless.

    Raises:
        InputError: If `out` is not a Markdown file.
    """
    check_out(out)
    num_triangles = QUICK.num_triangles if quick else FULL.num_triangles
    report = measure(num_triangles, 3 if quick else _NUM_ROUNDS)
    show_report(report, out, console)
    return report


def measure(num_triangles: int, num_rounds: int) -> Report:
    """Time substeps, motility, whole frames and finite elements, one after the other."""
    with console.status("generating the colon"):
        stage = make_stage(make_organ(num_triangles, seed=_SEED), num_views=8)
    parts = (_substeps, _wave, _frames, _finite_elements)
    results = []
    for part in parts:  # without a spinner: its thread would disturb the timing
        console.print(f"timing {part.__name__.strip('_').replace('_', ' ')} …")
        results.append(part(stage, num_rounds))
    return Report(
        title="Physics speed",
        command="vrcaps bench world",
        setting=(
            f"A generated colon of {stage.num_triangles} triangles, default tissue with the "
            f"spring wall, default substep of {1e6 * SUBSTEP:.0f} µs; {stage.model.device.name} "
            f"released in three views and left for {_REST:g} s. {num_rounds} repetitions. Times "
            "are on the clock, and in processor time of all threads together."
        ),
        claims=tuple(claim for claim, _ in results),
        tables=tuple(table for _, table in results),
        machine=machine_facts(),
    )


def _timed(call: Callable[[], object], num_rounds: int) -> Timed:
    for _ in range(_WARM):
        call()
    wall, cpu = np.empty(num_rounds), np.empty(num_rounds)
    for k in range(num_rounds):
        started = time.process_time(), time.perf_counter()
        call()
        cpu[k], wall[k] = time.process_time() - started[0], time.perf_counter() - started[1]
    return Timed(wall, cpu)


def _world(stage: Stage, view: int, tissue: Tissue, substep: float = SUBSTEP) -> World:
    """World with a capsule at rest."""
    start = replace(stage.states[view], vertices_world=None)
    world = World(stage.model, tissue, start, substep=substep)
    for _ in range(10):
        world.step(Control(), _REST / 10)
    return world


def _substeps(stage: Stage, num_rounds: int) -> tuple[Claim, Table]:
    count, rows, slowest = 200, [], None
    for view in _VIEWS:
        world = _world(stage, view, Tissue())
        times = _timed(lambda world=world: world.step(Control(), count * SUBSTEP), num_rounds)
        contact = world.state.contact
        assert contact is not None
        note = f"{1e6 * contact.area:.0f} mm² touched, {1e3 * contact.depth:.2f} mm deep"
        rows.append(times.row(f"view {view}", note, 1e6 / count))
        if slowest is None or np.median(times.cpu) > np.median(slowest):
            slowest = times.cpu
    assert slowest is not None
    claim = replace(claims.SUBSTEPS, measured=Spread.of(count / slowest))
    table = Table("A substep in resting contact", ("µs", "µs of processors"), tuple(rows))
    return claim, table


def _wave(stage: Stage, num_rounds: int) -> tuple[Claim, Table]:
    world = _world(stage, _VIEWS[0], Tissue(motility=Motility()))
    wall = MovingWall(stage.model)

    def wave() -> None:
        world.step(Control(), SUBSTEP)
        wall.at(world.state)

    times = _timed(wave, num_rounds)
    note = "as a recording does: a world's step with one substep, its state, the renderer's wall"
    table = Table(
        "Muscle wave",
        ("ms", "ms of processors"),
        (times.row("wave, wall and refit", note, 1e3),),
    )
    return replace(claims.WAVE, measured=Spread.of(1e3 * times.cpu)), table


def _frames(stage: Stage, num_rounds: int) -> tuple[Claim, Table]:
    from vrcaps.render.renderer import Renderer
    from vrcaps.render.settings import RenderSettings

    plain, rows, rates = RenderSettings(light="direct", shadows=False), [], []
    cases = ((SUBSTEP, RenderSettings()), (SUBSTEP, plain), (_COARSER, plain))
    for substep, settings in cases:
        renderer = Renderer(stage.model, settings)
        world = _world(stage, _VIEWS[0], Tissue(motility=Motility()), substep)
        frame = renderer.render(world.state, stage.camera)

        def step(world: World = world, renderer: Renderer = renderer, frame: Frame = frame) -> None:
            world.step(Control(), _FRAME)
            renderer.render(world.state, stage.camera, out=frame)

        times = _timed(step, num_rounds)
        light = "direct light, no shadows" if settings is plain else "light by default"
        name = f"{1e6 * substep:.0f} µs, {light}"
        rows.append(times.row(name, "a step of 1/60 s, state, complete frame", 1e3))
        rates.append(Spread.of(1.0 / times.wall))
    table = Table("A rendered and labeled step", ("ms", "ms of processors"), tuple(rows))
    return replace(claims.LIVING_FRAMES, measured=rates[0]), table


def _finite_elements(stage: Stage, num_rounds: int) -> tuple[Claim, Table]:
    organ = stage.model.organ
    wall = FemWall(organ, FemDeformation(edge=_FEM_EDGE))
    middle = organ.vertices[np.argmin(np.abs(organ.arc_length - 0.5))]
    near = np.linalg.norm(organ.vertices - middle, axis=1) < 5.0 * MM
    force = np.where(near[:, None], -organ.normals * (0.5 / near.sum()), 0.0)
    times = _timed(lambda: wall.step(force, _FEM_STEP), num_rounds)
    note = f"{wall.num_dof} degrees of freedom, linear, a step of {1e3 * _FEM_STEP:g} ms"
    table = Table("Finite elements", ("ms", "ms of processors"), (times.row("step", note, 1e3),))
    if wall.num_dof < _MIN_DOF:
        reason = f"{wall.num_dof} degrees of freedom are too few"
        return replace(claims.FINITE_ELEMENTS, reason=reason), table
    return replace(claims.FINITE_ELEMENTS, measured=Spread.of(1.0 / times.cpu)), table
