"""Claim: a wall of 20,000 degrees of freedom takes 100 steps/s or more on one core.

Reference: the promise of `docs/tissue.md`. CPU time of this process, so that other work on the
machine counts little; single-threaded but for carrying the organ's vertices.

    python benchmarks/speed_fem.py [--edge-mm 24] [--model neo-hookean]
"""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
import tyro

from vrcaps.organ.catalog import load_organ
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall
from vrcaps.units import MM

_DT = 5e-3
_FORCE = 0.5


def main(
    *, edge_mm: float = 24.0, model: Literal["linear", "neo-hookean"] = "linear", steps: int = 60
) -> None:
    """Push a generated colon of 113,000 triangles at one place and print what a step takes.

    Args:
        edge_mm: Length of the elements' edges [mm].
        model: Law of the wall.
        steps: How many to measure.
    """
    organ = load_organ("colon", seed=1)
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


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
