"""Claim: a collapsed small bowel has no self-intersections, at rest and around the capsule.

Draws patients, generates their small bowels without texture, and counts intersecting triangles of
the wall at rest and of the wall that closes around tilted capsules at random positions.

    python -m benchmarks.validation.collapsed_walls
    python -m benchmarks.validation.collapsed_walls --patients 100 --views 5
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
from vrcaps.anatomy.small_bowel import small_bowel_of
from vrcaps.capsule.device_file import read_device
from vrcaps.core.rng import stream
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.world.model import Model
from vrcaps.world.wall_displacement import WallDisplacement

TILT = 0.35
"""Maximum angle between the capsule and the centerline [rad]."""
HEAD = ("wall", "number", "with intersections", "intersecting pairs, largest", "triangles, median")


@dataclass(frozen=True)
class Count:
    """Intersections of one wall.

    Attributes:
        pairs: Intersecting pairs of triangles.
        triangles: Triangles that were examined.
    """

    pairs: int
    triangles: int


def main() -> None:
    """Measure, and write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--patients", type=int, default=20, help="number of patients")
    made.add_argument("--views", type=int, default=5, help="capsules for each patient")
    args = made.parse_args()
    at_rest, around = [], []
    for seed in range(args.patients):
        model = small_bowel_model(seed)
        organ = model.organ
        pairs = self_intersections(organ.vertices, organ.faces)
        at_rest.append(Count(len(pairs), len(organ.faces)))
        counts = list(counts_around(model, args.views, seed))
        around += counts
        print(f"patient {seed}: {len(pairs)}, {[count.pairs for count in counts]}", flush=True)
    text = f"""## Collapsed walls

Small bowels of {args.patients} patients of default settings, and {args.views} capsules in each.

{table(HEAD, [row("at rest", at_rest), row("around a capsule", around)])}

"""
    write_section(args.out, Path(__file__), text)


def small_bowel_model(seed: int) -> Model:
    """Model of a patient's collapsed small bowel without texture."""
    return Model(small_bowel_of(draw_patient_anatomy(seed, None)), read_device("mirocam"))


def counts_around(model: Model, views: int, seed: int) -> Iterator[Count]:
    """Intersections of the displaced part of a wall around capsules at random positions."""
    rng = stream(seed, "benchmark/collapsed-walls")
    wall, rest = WallDisplacement(model, model), model.vertices_world
    for position in rng.uniform(0.02, 0.98, views):
        angle = float(rng.uniform(-TILT, TILT))
        pose = model.place(position * model.organ.centerline.length, angle=angle).T_world_capsule
        vertices = wall.vertices_world(pose)
        assert vertices is not None
        moved = (vertices != rest).any(axis=1)
        faces = model.organ.faces[moved[model.organ.faces].any(axis=1)]
        yield Count(len(self_intersections(vertices, faces)), len(faces))


def row(name: str, counts: list[Count]) -> tuple[str, ...]:
    """Row of the table."""
    pairs = [count.pairs for count in counts]
    triangles = int(np.median([count.triangles for count in counts]))
    return name, *map(str, (len(counts), sum(map(bool, pairs)), max(pairs), triangles))


if __name__ == "__main__":
    main()
