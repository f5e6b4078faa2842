"""Claim: 5,000 steps of 1/30 s per second in environments on two cores, at most 15 % in Python.

Coverage of a generated stomach with the observations `state` and `map`, N worlds side by side under
smooth random actions: quasi-static, by a wrench that balances gravity and by a magnet, and by the
physics in substeps of 200 µs. A step is 1/30 s, an action five steps; visibility is tested once per
action. The baseline is Gymnasium's `AsyncVectorEnv` over as many single environments.

    python -m benchmarks.speed.env [--most 256]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from vrcaps import _core
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.env import CapsuleEnv, CapsuleVectorEnv, EnvSettings
from vrcaps.env.actuation import MagnetActuation, Wrench
from vrcaps.env.settings import env_settings

STEPS_PER_ACTION = 5
COUNTS = (1, 4, 16, 64, 256)
SECONDS = 3.0
"""Minimum time of the measurement of each row [s]."""
CORE = (
    *("step_worlds", "world_states", "worlds_inside"),
    *("settle_worlds", "mark_points", "wall_distances"),
)
HEAD = (
    *("dynamics", "actuation", "worlds", "steps per second", "per second of processor time"),
    *("of it dynamics", "visibility", "rest"),
)


def main() -> None:
    """Measure, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--most", type=int, default=COUNTS[-1], help="worlds, at most")
    args = made.parse_args()
    wrench = Wrench(force=5e-3, torque=1e-5, is_weightless=True, frame="capsule")
    organ, rows = generate_organ("stomach", seed=0), []
    for dynamics, actuation, counts in (
        ("quasi-static", wrench, COUNTS),
        ("quasi-static", MagnetActuation(), COUNTS),
        ("physics", wrench, (1, 16)),
        ("physics", MagnetActuation(), (1, 16)),
    ):
        settings = replace(
            env_settings(organs=(organ,), observations=("state", "map"), actuation=actuation),
            dynamics=dynamics,
            stuck_time=1e6,
            episode_time=1e6,
        )
        rows += [native(settings, count) for count in counts if count <= args.most]
        if dynamics == "quasi-static" and args.most >= 4:
            rows.append(asynchronous(settings, 4))
    text = f"""## Environment speed

`Coverage-v0` of a generated stomach, capsule `magnetic`, observations `state` and `map`, smooth
random actions; an action is five steps of 1/30 s, visibility by 4,096 points once per action;
{_core.num_threads()} threads. Fractions are of processor time: dynamics, visibility, and the rest
(observations, rewards, Python). Claimed: 5,000 quasi-static steps per second, 250 with full
physics, and a rest of at most 15 %. `AsyncVectorEnv` is Gymnasium's, a process for each world.

{table(HEAD, rows)}
"""
    write_section(args.out, Path(__file__), text)


def native(settings: EnvSettings, count: int) -> tuple[str, ...]:
    """Row of the table: a number of worlds in one call."""
    envs = CapsuleVectorEnv(settings, count)
    warm(envs)
    spent = dict.fromkeys(CORE, 0.0)
    kept = {name: getattr(_core, name) for name in CORE}
    for name, function in kept.items():
        setattr(_core, name, timed(function, name, spent))
    try:
        clock, processor, actions = run(envs)
    finally:
        for name, function in kept.items():
            setattr(_core, name, function)
    done = actions * count * STEPS_PER_ACTION
    dynamics = spent["step_worlds"] / processor
    sight = sum(spent[name] for name in CORE[3:]) / processor
    return (
        *(settings.dynamics, settings.actuation.kind, str(count)),
        *(f"{done / clock:.0f}", f"{done / processor:.0f}"),
        *(f"{100.0 * share:.0f} %" for share in (dynamics, sight, 1.0 - dynamics - sight)),
    )


def asynchronous(settings: EnvSettings, count: int) -> tuple[str, ...]:
    """Row of the table: processes of Gymnasium with one environment each."""
    makers = [lambda: CapsuleEnv(settings)] * count
    # A forked process has none of the core's threads and would wait for them.
    envs = gymnasium.vector.AsyncVectorEnv(makers, context="spawn")
    warm(envs)
    clock, _, actions = run(envs)
    envs.close()
    rate = actions * count * STEPS_PER_ACTION / clock
    name = f"{count} `AsyncVectorEnv`"
    kind = settings.actuation.kind
    return (settings.dynamics, kind, name, f"{rate:.0f}", "", "", "", "")


def warm(envs: Any) -> None:
    """Start episodes and take a few steps."""
    envs.reset(seed=0)
    envs.action_space.seed(0)
    for _ in range(3):
        envs.step(np.zeros(envs.action_space.shape, np.float32))


def run(envs: Any) -> tuple[float, float, int]:
    """Seconds of the clock and of processors under smooth random actions, and their number."""
    actions, number = np.zeros(envs.action_space.shape, np.float32), 0
    begin, used = time.perf_counter(), time.process_time()
    while time.perf_counter() - begin < SECONDS:
        actions = (0.8 * actions + 0.4 * envs.action_space.sample()).clip(-1.0, 1.0)
        envs.step(actions.astype(np.float32))
        number += 1
    return time.perf_counter() - begin, time.process_time() - used, number


def timed(function: Callable, name: str, spent: dict[str, float]) -> Callable:
    """Return the function with its processor time added to a counter."""

    def call(*args: Any, **keywords: Any) -> Any:
        begin = time.process_time()
        result = function(*args, **keywords)
        spent[name] += time.process_time() - begin
        return result

    return call


if __name__ == "__main__":
    main()
