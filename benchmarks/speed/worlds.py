"""Claim: quasi-static worlds step 5,000 times per second on two cores, each step 1/30 s.

Magnetic capsules in a generated stomach, each led along the upper wall by a separate magnet at
15 mm/s; N worlds in one call, by both dynamics: steps per second of wall-clock and of processor
time, the fraction of Python, cost of reading all of them, and memory and time to create a world.

    python -m benchmarks.speed.worlds [--most 256]
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from vrcaps import _core
from vrcaps.anatomy.stomach import StomachParameters, generate_stomach
from vrcaps.capsule.device_file import read_device
from vrcaps.core.units import MM
from vrcaps.magnet.sources import Cylinder
from vrcaps.world.batch import WorldBatch
from vrcaps.world.control import Control
from vrcaps.world.mechanics import DYNAMICS, DynamicsKind
from vrcaps.world.model import Model
from vrcaps.world.world import World

FRAME, SUBSTEP, SPEED = 1.0 / 30.0, 2e-4, 15.0 * MM
SETTLING, STEPS = 15, {"physics": 4, "quasi-static": 40}
COUNTS = (1, 4, 16, 64, 256)
HEAD = (
    "dynamics",
    "worlds",
    "steps per second",
    "per second of processor time",
    "Python's share",
    "reading a world",
    "making a world",
    "memory a world",
)


def main() -> None:
    """Measure, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--most", type=int, default=COUNTS[-1], help="worlds, at most")
    args = made.parse_args()
    organ = generate_stomach(StomachParameters().at("inflated"), seed=0)
    model = Model(organ, read_device("magnetic"))
    World(model)
    counts = [count for count in COUNTS if count <= args.most]
    rows = [row(model, count, dynamics) for dynamics in DYNAMICS for count in counts]
    text = f"""## Parallel-world speed

A generated stomach of {len(organ.faces)} triangles, the capsule `magnetic` at positions along it,
led along the upper wall by a magnet at {1e3 * SPEED:.0f} mm/s; steps of 1/30 s, physics in substeps
of {1e6 * SUBSTEP:.0f} µs, default tissue; {_core.num_threads()} threads. Reading is
`WorldBatch.state` and `are_inside`. Claimed: 5,000 quasi-static steps per second.

{table(HEAD, rows)}
"""
    write_section(args.out, Path(__file__), text)


def row(model: Model, count: int, dynamics: DynamicsKind) -> tuple[str, ...]:
    """Row of the table: a number of parallel worlds."""
    memory, begin = resident(), time.process_time()
    worlds = [made(model, k / count, dynamics) for k in range(count)]
    making = (time.process_time() - begin) / count
    memory = (resident() - memory) / count
    batch = WorldBatch(worlds)
    magnets = [coupling.Ts_world_magnet for world in worlds if (coupling := world.coupling)]
    for number in range(SETTLING):
        batch.step(commands(magnets, 0, lift=0.3 if number < 10 else 0.0), FRAME)
    clock, processor, reading = 0.0, 0.0, 0.0
    steps = STEPS[dynamics]
    for number in range(steps):
        controls = commands(magnets, number + 1)
        begin, used = time.perf_counter(), time.process_time()
        batch.step(controls, FRAME)
        clock += time.perf_counter() - begin
        processor += time.process_time() - used
        used = time.process_time()
        batch.state()
        batch.are_inside()
        reading += time.process_time() - used
    begin = time.process_time()
    for _ in range(10):
        batch.step(commands(magnets, steps), 1e-9)
    python = (time.process_time() - begin) / 10
    done = count * steps
    return (
        dynamics,
        str(count),
        f"{done / clock:.0f}",
        f"{done / processor:.0f}",
        f"≤ {100.0 * python * steps / processor:.0f} %",
        f"{1e6 * reading / done:.0f} µs",
        f"{1e3 * making:.1f} ms",
        f"{memory / 1e6:.0f} MB",
    )


def made(model: Model, share: float, dynamics: DynamicsKind) -> World:
    """World with a magnet above the upper wall, at a fraction of the middle half of the gut."""
    start = model.place((0.25 + 0.5 * share) * model.organ.centerline.length)
    above = start.T_world_capsule[None, :3, 3]
    distance, _ = model.wall.cast(above, np.array([[0.0, 0.0, 1.0]]))
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    pose[:3, 3] = above[0] + (0.0, 0.0, distance[0] + 0.09)
    sources = [Cylinder(50 * MM, 50 * MM, 1.3, pose)]
    return World(model, None, start, substep=SUBSTEP, sources=sources, dynamics=dynamics)


def commands(magnets: list[np.ndarray], number: int, lift: float = 0.0) -> list[Control]:
    """Positions of the magnets after a number of steps, and a force that lifts [N]."""
    way = np.zeros((4, 4))
    way[0, 3] = SPEED * FRAME * number
    return [
        Control(force_world=(0.0, 0.0, lift), Ts_world_magnet=Ts_world_magnet + way)
        for Ts_world_magnet in magnets
    ]


def resident() -> int:
    """Memory of this process [bytes]."""
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])


if __name__ == "__main__":
    main()
