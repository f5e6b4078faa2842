"""Claim: a wall of 20,000 degrees of freedom takes 100 steps/s or more on one core.

Reference: the promise of `docs/tissue.md`. CPU time of this process, so that other work on the
machine counts little; single-threaded but for carrying the organ's vertices.

With `--world` a capsule lies on the wall, and a step of the layer with the exchange of forces is
what a world on it takes beyond one whose wall does not move.

    python benchmarks/speed_fem.py [--edge-mm 24] [--model neo-hookean] [--world]
"""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
import tyro

from vrcaps.anatomy.catalog import generate_organ
from vrcaps.capsule.catalog import read_device
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall
from vrcaps.tissue.tissue import Tissue
from vrcaps.transforms import transform_from
from vrcaps.units import MM
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

_DT = 5e-3
_FORCE = 0.5


def main(
    *,
    edge_mm: float = 24.0,
    model: Literal["linear", "neo-hookean"] = "linear",
    steps: int = 60,
    world: bool = False,
) -> None:
    """Push a generated colon of 113,000 triangles at one place and print what a step takes.

    Args:
        edge_mm: Length of the elements' edges [mm].
        model: Law of the wall.
        steps: How many to measure.
        world: Measure a world with a capsule on the wall.
    """
    organ = generate_organ("colon", seed=1)
    if world:
        measure_world(organ, FemDeformation(edge=edge_mm * MM, model=model), steps)
        return
    begin = time.process_time()
    wall = FemWall(organ, FemDeformation(edge=edge_mm * MM, model=model))
    built = time.process_time() - begin
    middle = organ.vertices[np.argmin(np.abs(organ.arc_length - 0.5))]
    near = np.linalg.norm(organ.vertices - middle, axis=1) < 5.0 * MM
    force = np.where(near[:, None], -organ.normals * (_FORCE / near.sum()), 0.0)
    begin = time.process_time()
    wall.step(force, _DT)
    first = time.process_time() - begin
    taken, rounds = [], []
    for _ in range(steps):
        begin = time.process_time()
        wall.step(force, _DT)
        taken.append(time.process_time() - begin)
        rounds.append(wall.rounds)
    low, median, high = 1e3 * np.quantile(taken, [0.1, 0.5, 0.9])
    print(
        f"{model}, {wall.num_dof:,} degrees of freedom, {len(organ.faces):,} triangles: "
        f"{1e3 / median:.0f} steps/s; a step {median:.2f} ms (p10 {low:.2f}, p90 {high:.2f}), "
        f"{np.median(rounds):.0f} back-substitutions; building {built:.1f} s, factor and first "
        f"step {first:.2f} s"
    )


def measure_world(organ: OrganSurface, deformation: FemDeformation, steps: int) -> None:
    """Print what the layer and the exchange take of a world in which a capsule lies on the wall."""
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
    print(
        f"{deformation.model}, world of {num_dof:,} degrees of freedom: a step of the "
        f"layer with its exchange {1e3 * (soft - firm):.2f} ms, {1.0 / (soft - firm):.0f} Hz; "
        f"with its capsule's {1e3 * soft:.2f} ms"
    )


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
