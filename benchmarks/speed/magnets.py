"""Claim: 8 sources take at most 2 µs per substep, arm and controller 200 µs per control step.

Field, gradient and wrench, CPU time on one core: for many poses of a capsule with one magnet in it,
the median of batches with p10 and p90. The sources are 2 to 4 sizes from the capsule, where the
closed forms of cylinders and coils cost most, and farther away, where their series take over. A
control step: the call that a recording makes, in the run that makes it.

    python -m benchmarks.speed.magnets [--size POSES]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.anatomy.stomach import StomachParameters, generate_stomach
from vrcaps.capsule.device_file import read_device
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import (
    Coil,
    Cylinder,
    Dipole,
    FieldMap,
    InternalMagnet,
    Solenoid,
    Source,
    magnet_pose,
)
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.rollout import Rollout
from vrcaps.world.control import Control
from vrcaps.world.model import Model, posture_transform

BATCHES = 31
LIMIT = 2.0
COUNT = 8
FRAMES, RATE, WARM, MAX_CONTROL = 9, 2.0, 100, 200.0
CONTROL_HEAD = ("magnet held by", "control steps", "median", "p10 to p90", "claimed")
HEAD = ("8 sources", "distance", "a wrench, median", "p10 to p90", "claimed")


def kinds() -> dict[str, Source]:
    """One source of each kind, 100 mm wide."""
    return {
        "dipoles": Dipole(100.0),
        "cylinders": Cylinder(0.1, 0.1, 1.48),
        "coils": Coil(0.05, 10.0, 100),
        "solenoids": Solenoid(0.05, 0.1, 10.0, 100),
        "sampled maps": FieldMap((-1, -1, -1), (0.1,) * 3, np.ones((21, 21, 21, 3))),
    }


def around(source: Source, distance: float) -> list[Source]:
    """Eight sources around the origin with different orientations."""
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
    """Rows of the control step within a recording, for a free magnet and an arm."""
    organ = generate_stomach(StomachParameters().at("inflated"), seed=0)
    model, rows = Model(organ, read_device("magnetic"), posture_transform("supine")), []
    for arm in (None, "panda"):
        steering = MagnetSteering(arm=arm, standoff=0.03, wall="upper", end=0.85)
        motion = Dynamics(start=0.05, magnet=steering)
        run = Rollout(model, motion, frames=FRAMES, fps=RATE, seed=0)
        assert run.program is not None
        taken: list[float] = []
        run.program.control = timed(run.program.control, taken)
        list(run.steps())
        low, median, high = np.quantile(taken[WARM:], [0.1, 0.5, 0.9])
        said = f"≤ {MAX_CONTROL:g} µs: {'yes' if median <= MAX_CONTROL else 'NO'}"
        actuator = "a free hand" if arm is None else "the Panda"
        spread = f"{low:.0f} to {high:.0f} µs"
        rows.append((actuator, str(len(taken) - WARM), f"{median:.0f} µs", spread, said))
    return rows


def timed(call: Callable[..., Control], taken: list[float]) -> Callable[..., Control]:
    """Call whose processor times [µs] are recorded."""

    def made(*given: Any) -> Control:
        begin = time.process_time()
        control = call(*given)
        taken.append(1e6 * (time.process_time() - begin))
        return control

    return made


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
    text = f"""## Magnet speed

`python -m benchmarks.speed.magnets`: CPU time on one core. Field, gradient and wrench of eight
sources, 100 mm across, on a capsule with one magnet:

{table(HEAD, rows)}

A control step as `vrcaps record --motion dynamics --set motion.magnet={{}}` makes it: the capsule
`magnetic` is led along the upper wall of the inflated stomach of examples/07_magnet_stomach.py,
{RATE:g} frames per second, substeps of 50 µs. The whole call of the program between two steps of
the world is timed: target on the wall, controller, magnet or arm. Processor time of all threads.

{table(CONTROL_HEAD, control_rows())}"""
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
