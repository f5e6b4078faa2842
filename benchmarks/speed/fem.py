"""Claim: a wall of 20,000 degrees of freedom or more takes 100 steps/s or more on one core.

CPU time of this process, so that other work on the machine counts little; single-threaded but for
carrying the organ's vertices. In a world a capsule lies on the wall, and a step of the layer with
the exchange of forces is the time of that world minus that of one whose wall does not move.

    python -m benchmarks.speed.fem [--size STEPS]
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import transform_from
from vrcaps.core.units import MM
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

_DT = 5e-3
_FORCE = 0.5
_CLAIMED = 100.0
_WALLS: tuple[tuple[Literal["linear", "neo-hookean"], float], ...] = (
    ("linear", 22.0),
    ("linear", 16.0),
    ("neo-hookean", 22.0),
)
HEAD = (
    "wall", "edge [mm]", "degrees of freedom", "steps/s", "a step [ms], p10 to p90",
    "back-substitutions", "building, factor and first step [s]", "claimed",
)  # fmt: skip


def main() -> None:
    """Measure, write the table."""
    given = options(__doc__ or "", size=60)
    organ = generate_organ("colon", seed=1)
    rows = [
        row(organ, FemDeformation(edge=edge * MM, model=law), given.size) for law, edge in _WALLS
    ]
    rows.append(world_row(organ, FemDeformation(edge=22.0 * MM), given.size))
    text = f"""## Elastic-wall speed

A generated colon of {len(organ.faces):,} triangles, pushed at one point; steps of
{1e3 * _DT:g} ms. Processor time of all threads, median of {given.size} steps. In a world:
additional time for a step of the layer and the exchange of forces with a capsule on it, compared
with a world whose wall does not move.

{table(HEAD, rows)}
"""
    write_section(given.out, Path(__file__), text)


def row(organ: OrganSurface, deformation: FemDeformation, steps: int) -> tuple[str, ...]:
    """Time of a step of a wall."""
    begin = time.process_time()
    wall = FemWall(organ, deformation)
    middle = organ.vertices[np.argmin(np.abs(organ.arc_length - 0.5))]
    near = np.linalg.norm(organ.vertices - middle, axis=1) < 5.0 * MM
    force = np.where(near[:, None], -organ.normals * (_FORCE / near.sum()), 0.0)
    wall.step(force, _DT)
    first = time.process_time() - begin
    taken, rounds = [], []
    for _ in range(steps):
        begin = time.process_time()
        wall.step(force, _DT)
        taken.append(time.process_time() - begin)
        rounds.append(wall.rounds)
    low, median, high = 1e3 * np.quantile(taken, [0.1, 0.5, 0.9])
    good = median <= 1e3 / _CLAIMED and wall.num_dof >= 20_000
    is_claimed = deformation.model == "linear" and deformation.edge > 20.0 * MM
    return (
        deformation.model,
        f"{deformation.edge / MM:g}",
        f"{wall.num_dof:,}",
        f"{1e3 / median:.0f}",
        f"{median:.2f}, {low:.2f} to {high:.2f}",
        f"{np.median(rounds):.0f}",
        f"{first:.1f}",
        f"≥ {_CLAIMED:g}: {'yes' if good else 'NO'}" if is_claimed else "",
    )


def world_row(organ: OrganSurface, deformation: FemDeformation, steps: int) -> tuple[str, ...]:
    """Cost of the layer and the exchange of forces in a world with a capsule on the wall."""
    model = Model(organ, read_device("mirocam"))
    line = organ.centerline
    place = int(np.argmin(np.abs(line.arc_length - 0.7)))
    start = transform_from(line.frames[place], line.points[place])
    taken, num_dof = [], 0
    for wall in (None, deformation):
        world = World(model, Tissue(deformation=wall), State(0.0, model.T_world_patient @ start))
        for _ in range(16):
            world.step(Control(), 0.05)
        begin = time.process_time()
        for _ in range(max(1, steps // 10)):
            world.step(Control(), 10 * _DT)
        taken.append((time.process_time() - begin) / (10 * max(1, steps // 10)))
        num_dof = 0 if world.layer is None else world.layer.num_dof
    firm, soft = taken
    name, edge = f"{deformation.model}, in a world", f"{deformation.edge / MM:g}"
    rate, middle = f"{1.0 / (soft - firm):.0f}", f"{1e3 * (soft - firm):.2f}"
    return name, edge, f"{num_dof:,}", rate, middle, "", "", ""


if __name__ == "__main__":
    main()
