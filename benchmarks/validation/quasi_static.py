"""Claim: quasi-static motion under a magnet agrees with the full physics within 0.5 mm (median).

Generated stomachs and colons, a magnetic capsule at three positions of each, settled by the
physics; from there the same commands under both dynamics: the twist of a free magnet outside that
leads the capsule along the upper wall, and a wrench without any magnet. A wrench gives a capsule
momentum, which quasi-static motion neglects: that row states the resulting distance.

    python -m benchmarks.validation.quasi_static [--stomachs 10] [--colons 5]
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector
from vrcaps.core.units import MM
from vrcaps.magnet.sources import Cylinder
from vrcaps.world.control import Control
from vrcaps.world.mechanics import DYNAMICS, DynamicsKind
from vrcaps.world.model import Model
from vrcaps.world.snapshot import Snapshot
from vrcaps.world.world import World

FRAME, SUBSTEP = 1.0 / 30.0, 2e-4
SETTLING, STEPS = 45, 90
PLACES = (0.3, 0.5, 0.7)
SPEED, TURN = 15.0 * MM, np.radians(10.0)
PUSH, PUSHED, LIFT, LIFTED = 0.02, 15, 0.3, 15
HEIGHT = {"stomach": 0.09, "colon": 0.12}
"""Height of the magnet above the upper wall [m]."""
COMMANDS = ("magnet", "wrench")
HEAD = (
    "organs, command",
    "runs",
    "path apart",
    "heading apart",
    "contact force, physics",
    "quasi-static",
    "speed, physics",
    "quasi-static",
    "in the lumen",
    "time of the physics",
)


@dataclass(frozen=True)
class Run:
    """One run: result of each step.

    Attributes:
        rows: Position [mm], heading, contact force [mN] and speed [mm/s] of each step.
        is_inside: Whether the axis was in the lumen after every step.
        seconds: Processor time.
    """

    rows: np.ndarray
    is_inside: bool
    seconds: float


def main() -> None:
    """Run both dynamics, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--stomachs", type=int, default=10)
    made.add_argument("--colons", type=int, default=5)
    args = made.parse_args()
    rows, failed = [], 0
    for kind, count in (("stomach", args.stomachs), ("colon", args.colons)):
        pairs: dict[str, list[tuple[Run, Run]]] = {command: [] for command in COMMANDS}
        for seed in range(count):
            model = Model(generate_organ(kind, seed=seed), read_device("magnetic"))
            for command in COMMANDS:
                for place in PLACES:
                    try:
                        pairs[command].append(pair(model, HEIGHT[kind], place, command))
                    except InputError:
                        failed += 1
        rows += [row(f"{count} {kind}s, {name}", some) for name, some in pairs.items() if some]
    text = f"""## Quasi-static dynamics

The capsule `magnetic` at {len(PLACES)} places of generated organs, settled by the physics for
{SETTLING * FRAME:.1f} s, then {STEPS * FRAME:.0f} s in steps of 1/30 s. `magnet`: a cylinder of
50 mm with 1.3 T, {1e3 * HEIGHT["stomach"]:.0f} mm above the upper wall of a stomach and
{1e3 * HEIGHT["colon"]:.0f} mm above that of a colon, goes along the gut at {1e3 * SPEED:.0f} mm/s
and turns by {np.degrees(TURN):.0f}°/s. `wrench`: no magnet, {1e3 * PUSH:.0f} mN along the gut for
{PUSHED * FRAME:.1f} s, then nothing. Physics in substeps of {1e6 * SUBSTEP:.0f} µs.
Over all instants of all runs, median and 90th percentile; `in the lumen` counts quasi-static runs
whose capsule never left it; the last column is the physics' processor time over the quasi-static
one's. {failed} runs in which the capsule was pulled to the magnet are excluded.

{table(HEAD, rows)}
"""
    write_section(args.out, Path(__file__), text)


def pair(model: Model, height: float, place: float, command: str) -> tuple[Run, Run]:
    """Full-physics and quasi-static run from the same state."""
    worlds = {name: world(model, height, place, command, name) for name in DYNAMICS}
    start = settled(worlds["physics"], command)
    physics, quasi_static = (run(worlds[name], start, command) for name in DYNAMICS)
    return physics, quasi_static


def world(model: Model, height: float, place: float, command: str, dynamics: DynamicsKind) -> World:
    """The capsule on the centerline, a magnet that lies along the gut above the upper wall."""
    start = model.place(place * model.organ.centerline.length)
    above = start.T_world_capsule[None, :3, 3]
    distance, _ = model.wall.cast(above, np.array([[0.0, 0.0, 1.0]]))
    along, up = along_gut(start.T_world_capsule), np.array([0.0, 0.0, 1.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(up, along), up, along], axis=1)
    pose[:3, 3] = above[0] + (distance[0] + height) * up
    sources = [Cylinder(50 * MM, 50 * MM, 1.3, pose)] if command == "magnet" else []
    return World(model, None, start, substep=SUBSTEP, sources=sources, dynamics=dynamics)


def along_gut(T_world_capsule: np.ndarray) -> np.ndarray:
    """Level direction along the gut."""
    along = T_world_capsule[:3, 2] * (1.0, 1.0, 0.0)
    return along / np.linalg.norm(along)


def settled(physics: World, command: str) -> Snapshot:
    """Initial state: at the upper wall next to a magnet, otherwise at rest under gravity."""
    for number in range(SETTLING):
        lift = LIFT if command == "magnet" and number < LIFTED else 0.0
        physics.step(Control(force_world=(0.0, 0.0, lift)), FRAME)
    return physics.snapshot()


def run(world: World, start: Snapshot, command: str) -> Run:
    """One run from a state."""
    world.restore(start)
    along = along_gut(world.T_world_capsule)
    rows, is_inside, before = [], True, time.process_time()
    for control in controls(world, along, command):
        world.step(control, FRAME)
        pose, force = world.T_world_capsule, np.linalg.norm(world.contact_force_world)
        speed = np.linalg.norm(world.velocity_world[0])
        rows.append([*1e3 * pose[:3, 3], *pose[:3, 2], 1e3 * force, 1e3 * speed])
        is_inside &= world.is_inside()
    return Run(np.array(rows), is_inside, time.process_time() - before)


def controls(world: World, along: np.ndarray, command: str) -> Iterator[Control]:
    """The commands of a run, step by step."""
    coupling = world.coupling
    for number in range(STEPS):
        if command == "wrench" or coupling is None:
            yield Control(force_world=PUSH * along * (number < PUSHED))
            continue
        since = (number + 1) * FRAME
        poses = coupling.Ts_world_magnet.copy()
        turn = rotation_from_vector(np.array([0.0, 0.0, TURN * since]))
        poses[0, :3, 3] += SPEED * since * along
        poses[0, :3, :3] = turn @ poses[0, :3, :3]
        yield Control(Ts_world_magnet=poses)


def row(name: str, pairs: list[tuple[Run, Run]]) -> tuple[str, ...]:
    """A line of the table."""
    physics, quasi = (np.concatenate([pair[k].rows for pair in pairs]) for k in (0, 1))
    apart = np.linalg.norm(physics[:, :3] - quasi[:, :3], axis=1)
    cosine = np.clip((physics[:, 3:6] * quasi[:, 3:6]).sum(axis=1), -1.0, 1.0)

    def spread(values: np.ndarray, unit: str, digits: int = 0) -> str:
        middle, high = np.percentile(values, [50, 90])
        return f"{middle:.{digits}f} ({high:.{digits}f}) {unit}"

    seconds = [sum(pair[k].seconds for pair in pairs) for k in (0, 1)]
    return (
        name,
        str(len(pairs)),
        spread(apart, "mm", 2),
        spread(np.degrees(np.arccos(cosine)), "°", 1),
        spread(physics[:, 6], "mN"),
        spread(quasi[:, 6], "mN"),
        spread(physics[:, 7], "mm/s", 1),
        spread(quasi[:, 7], "mm/s", 1),
        f"{sum(pair[1].is_inside for pair in pairs)} of {len(pairs)}",
        f"{seconds[0] / seconds[1]:.0f} times",
    )


if __name__ == "__main__":
    main()
