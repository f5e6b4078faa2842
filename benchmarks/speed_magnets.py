"""Claim: 8 sources take at most 2 µs a substep, arm and controller 200 µs a control step.

CPU time on one core. Field, gradient and wrench: for many poses of a capsule with one magnet in it,
the median of batches with p10 and p90. The sources are 2 to 4 sizes from the capsule, where the
closed forms of cylinders and coils cost most, and farther away, where their series take over. A
control step: a capsule held in a tube by a magnet, in a loop of its own and between the steps of a
world, after which the caches hold other data.

    python benchmarks/speed_magnets.py [--size POSES]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from validation import ROOT, options, table, write_section

sys.path.append(str(ROOT / "tests" / "support"))

from tubes import straight_gut
from vrcaps.actuation.capsule_target import centerline_target
from vrcaps.actuation.steering_program import MagnetSteering, Waypoint
from vrcaps.capsule.catalog import read_device
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.internal import InternalMagnet
from vrcaps.magnet.sources import Coil, Cylinder, Dipole, FieldMap, Solenoid, Source, magnet_pose
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.rollout import Rollout
from vrcaps.world.control import Control
from vrcaps.world.model import Model
from vrcaps.world.world import World

BATCHES = 31
LIMIT = 2.0
COUNT = 8
STEPS, DT, MOST_CONTROL = 400, 0.01, 200.0
PLACE, SKIN = 0.1, 0.1
CONTROL_HEAD = ("a control step of", "after", "median", "p10 to p90", "claimed")
HEAD = ("8 sources", "distance", "a wrench, median", "p10 to p90", "claimed")


def kinds() -> dict[str, Source]:
    """One of each kind, 100 mm across."""
    return {
        "dipoles": Dipole(100.0),
        "cylinders": Cylinder(0.1, 0.1, 1.48),
        "coils": Coil(0.05, 10.0, 100),
        "solenoids": Solenoid(0.05, 0.1, 10.0, 100),
        "sampled maps": FieldMap((-1, -1, -1), (0.1,) * 3, np.ones((21, 21, 21, 3))),
    }


def around(source: Source, distance: float) -> list[Source]:
    """Eight of them around the origin, each turned its own way."""
    rng = np.random.default_rng(0)
    values = {k: v for k, v in source.__dict__.items() if k != "T_world_magnet"}
    places = rng.normal(size=(COUNT, 3))
    places *= distance / np.linalg.norm(places, axis=1, keepdims=True)
    axes = rng.normal(size=(COUNT, 3))
    poses = [magnet_pose(p, a) for p, a in zip(places, axes, strict=True)]
    return [type(source)(**values, T_world_magnet=pose) for pose in poses]


def measure(sources: list[Source], count: int) -> np.ndarray:
    """µs of CPU time for a wrench: p10, median, p90 over batches."""
    core = SourceSet(sources).core
    rng = np.random.default_rng(1)
    magnet = InternalMagnet((0, 0, 0.003), (0.3, 0, 1.0))
    magnets = np.array([[*magnet.position_capsule, *magnet.moment_capsule]])
    poses = np.concatenate([rng.uniform(-0.01, 0.01, (count, 3)), rng.normal(size=(count, 4))], 1)
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    core.wrench(magnets, poses)
    taken = []
    for _ in range(BATCHES):
        begin = time.process_time()
        core.wrench(magnets, poses)
        taken.append(1e6 * (time.process_time() - begin) / count)
    return np.quantile(taken, [0.1, 0.5, 0.9])


def control_rows() -> list[tuple[str, ...]]:
    """Rows of what a control step takes, by hand and by arm, without and with its target."""
    organ = straight_gut({"jejunum": 0.2}, radius=0.014)
    model, rows = Model(organ, read_device("magnetic"), np.eye(4)), []
    target = centerline_target(organ.centerline, np.eye(4), PLACE)
    for arm in (None, "panda"):
        steering = MagnetSteering(arm=arm, standoff=SKIN, waypoints=(Waypoint(0.0, PLACE),))
        motion = Dynamics(start=0.5, settle=1.0, substep=2e-4, magnet=steering)
        run = Rollout(model, motion, frames=1, fps=1.0, seed=0)
        list(run.steps())
        program, world = run.program, run.world
        assert program is not None
        actuator = "the magnet in a free hand" if arm is None else "the magnet on the Panda"
        alone = partial(program.controller.track, world, target, DT)
        whole = partial(program.control, world, 0.0, DT, np.eye(4))
        for moving in (None, world):
            rows.append(row(f"loop and {actuator}", alone, moving))
            rows.append((*row("the same with a target on the gut's wall", whole, moving)[:-1], ""))
    return rows


def row(what: str, call: Callable[[], Control], world: World | None) -> tuple[str, ...]:
    """A row of the time that a control step takes, after others or after steps of a world."""
    taken = []
    for _ in range(STEPS):
        begin = time.thread_time()
        control = call()
        taken.append(1e6 * (time.thread_time() - begin))
        if world is not None:
            world.step(control, DT)
    low, median, high = np.quantile(taken, [0.1, 0.5, 0.9])
    said = f"≤ {MOST_CONTROL:g} µs: {'yes' if median <= MOST_CONTROL else 'NO'}"
    after = "the one before" if world is None else "a step of the world"
    return what, after, f"{median:.0f} µs", f"{low:.0f} to {high:.0f} µs", said


def main() -> None:
    """Measure, write the table."""
    given = options(__doc__ or "", size=10_000)
    rows = []
    for name, source in kinds().items():
        for distance in (0.1, 0.15, 0.3):
            low, median, high = measure(around(source, distance), given.size)
            said = f"≤ {LIMIT:g} µs: {'yes' if median <= LIMIT else 'NO'}"
            spread = f"{low:.2f} to {high:.2f} µs"
            rows.append((name, f"{1e3 * distance:.0f} mm", f"{median:.2f} µs", spread, said))
    text = f"""## Speed of magnets

`python benchmarks/speed_magnets.py`: CPU time on one core. Field, gradient and wrench of eight
sources, 100 mm across, on a capsule with one magnet:

{table(HEAD, rows)}

A step of the loop that holds the capsule `magnetic` in a tube, magnet `cylinder-76.2`; the Panda
keeps all its limits and off itself:

{table(CONTROL_HEAD, control_rows())}"""
    write_section(given.out, Path(__file__).name, text)


if __name__ == "__main__":
    main()
