"""Claim: a planner with the observations of a device covers a stomach by magnet under gravity.

Evaluates it beside trivial policies, beside itself with the true pose and exact distances, beside a
trained policy with the same observations, and beside the ideal policy, in stomachs that no training
used. If interrupted, the same command resumes.

    python -m benchmarks.validation.device_policies [--size EPISODES] [--run FOLDER] [--only NAME]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.common.scripts import ROOT, parser, table, write_section
from vrcaps.core import rng
from vrcaps.env.actuation import MagnetActuation
from vrcaps.env.observations import ImageObservation, StateObservation
from vrcaps.env.settings import EnvSettings, env_settings, plain_environment
from vrcaps.env.tasks import CoverageTask
from vrcaps.metrics.bootstrap import bootstrap
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.evaluate import Plan, evaluate
from vrcaps.policy.evaluation import PAPER_TIME, Evaluation
from vrcaps.policy.policy import Policy, Requirements

if TYPE_CHECKING:
    from vrcaps.env.vector_env import CapsuleVectorEnv

TIMES = (PAPER_TIME, 120.0, 300.0)
ORGANS, SUBSTEP = "stomach:100-119", 5e-4
PERCENTILES = (50, 95, 99, 100)
HEAD = (
    "policy", "episodes", *(f"visible at {time:g} s" for time in TIMES),
    "force: 50 %", "95 %", "99 %", "largest", "throws", "wall escapes",
)  # fmt: skip


class Rest:
    """No motion of the magnet."""

    requires = Requirements({"control_period": 0.1}, actuations=("magnet",))

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Do nothing."""

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return zeros."""
        return np.zeros((env.num_envs, 6), np.float32)


class RandomTwist(Rest):
    """Uniformly random twist of the magnet, held for a second."""

    def __init__(self) -> None:
        self._draws: dict[int, np.random.Generator] = {}
        self._held: dict[int, np.ndarray] = {}
        self._count = 0

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Start a random stream for each world."""
        self._count = 0
        for index, seed in zip(np.asarray(indices).tolist(), seeds, strict=True):
            self._draws[index] = rng.stream(int(seed), "benchmark/random-twist")

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return the held twists."""
        if self._count % round(1.0 / env.settings.control_period) == 0:
            self._held = {k: draw.uniform(-1.0, 1.0, 6) for k, draw in self._draws.items()}
        self._count += 1
        return np.array([self._held[k] for k in range(env.num_envs)], np.float32)


@dataclass(frozen=True)
class Case:
    """A row of the table.

    Attributes:
        title: Text of the row.
        policy: Name of a policy, or None for a class of this file.
        changes: Settings that differ from those that the policy requires.
        make: Class of a policy of this file.
        organs: Number of organs.
    """

    title: str
    policy: str = ""
    changes: dict[str, Any] | None = None
    make: type[Rest] = Rest
    organs: int = 20

    def create(self) -> tuple[Policy, EnvSettings]:
        """Policy, and its environment with full physics."""
        policy: Any = read_policy(self.policy) if self.policy else self.make()
        keywords = {"actuation": MagnetActuation()} | dict(policy.requires.settings)
        given = keywords | (self.changes or {})
        settings = env_settings(**given | {"dynamics": "physics", "organs": (ORGANS,)})
        end, task = TIMES[-1], CoverageTask(target=1.0)
        settings = replace(settings, substep=SUBSTEP, episode_time=end, stuck_time=2.0 * end)
        return policy, replace(settings, task=task)


EXACT = (StateObservation(), ImageObservation("ray_distance", size=(40, 40)))
CASES = {
    "rest": Case("magnet at rest", organs=10),
    "random": Case("random twist", make=RandomTwist, organs=10),
    "explorer": Case("`explorer`, magnet", "explorer"),
    "arm": Case("`explorer`, arm", "explorer", {"actuation": "arm"}, organs=10),
    "exact": Case(
        "`explorer`, magnet, true pose, exact distances", "explorer", {"observations": EXACT}
    ),
    "trained": Case("`coverage-device`, magnet", "coverage-device", organs=10),
    "ideal": Case("`coverage-ppo`, ideal wrench, no gravity, true unseen regions", "coverage-ppo"),
}


def main() -> None:
    """Evaluate, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--size", type=int, default=1, help="episodes in each of 20 stomachs")
    made.add_argument("--run", type=Path, default=ROOT / "build" / "device", help="folder")
    made.add_argument("--only", choices=sorted(CASES), help="evaluate this row, write no table")
    given = made.parse_args()
    names = [given.only] if given.only else list(CASES)
    found = {name: run_case(CASES[name], given.run / name, given.size) for name in names}
    if given.only:
        return
    rows = [row(CASES[name].title, evaluation) for name, evaluation in found.items()]
    episodes, substep = given.size, f"{1e3 * SUBSTEP:g} ms"
    text = f"""## Policies with the observations of a device

`python -m benchmarks.validation.device_policies`: stomachs 100 to 119, or to 109 in rows of ten
episodes, {episodes} episode in each, full physics with gravity in substeps of {substep}, capsule
`magnetic`, magnet `cylinder-76.2` that moves at up to 5 cm/s and 1 rad/s, by hand or on a Panda
arm. `explorer` reads the pose that a Kalman filter estimates from IMU and Hall sensors, the
commanded pose of the magnet, and an image of 40 × 40 distances whose errors (5 % common to an
image, 5 % of each pixel) stand for those of a depth network; it plans in a map that it builds from
them. `coverage-device` is a network with the same pose and features of such a map; it imitates
`explorer` in stomachs 0 to 15. Mean
coverage `visible` with the 95 % interval of a bootstrap over organs; an episode that ends keeps its
coverage. Force: sum of the normal forces of the wall, mean over an action, percentiles over all
actions. A throw, faster than 1.5 m/s, ends an episode.

{table(HEAD, rows)}

{distance(found)}"""
    write_section(given.out, Path(__file__), text)


def run_case(case: Case, folder: Path, episodes: int) -> Evaluation:
    """Run the missing episodes of a row."""
    policy, settings = case.create()
    policy.requires.check(settings, case.title)
    evaluation = Evaluation(
        folder, {"policy": case.title, "environment": plain_environment(settings)}
    )
    plan = Plan(case.organs, episodes, worlds=episodes)
    evaluate(policy, settings, plan, evaluation, lambda done, total: print(folder, done, total))
    return evaluation


def coverage_cells(evaluation: Evaluation) -> list[tuple[float, str]]:
    """Mean coverage at each time with its interval [%]."""
    organs, values = evaluation.column("organ"), evaluation.over_time("visible", np.array(TIMES))
    cells = []
    for column in values.T:
        found = bootstrap(lambda items, c=column: c[items].mean(), len(column), groups=organs)
        cells.append((found.value, f"{found.value:.1f} % [{found.low:.1f}, {found.high:.1f}]"))
    return cells


def row(title: str, evaluation: Evaluation) -> tuple[str, ...]:
    """A row of the table."""
    rows = evaluation.rows
    curves = [evaluation.episode_curves(one)["normal_force_n"][1:] for one in rows]
    forces = np.percentile(np.concatenate(curves), PERCENTILES)
    throws = sum(one["end"] == "too fast" for one in rows)
    escapes = sum(one["wall_escapes"] for one in rows)
    newtons = (f"{force:.3f} N" for force in forces)
    shown = (text for _, text in coverage_cells(evaluation))
    return (title, str(len(rows)), *shown, *newtons, str(throws), str(escapes))


def distance(found: dict[str, Evaluation]) -> str:
    """Paragraph on the distance to the ideal policy."""
    device, ideal, exact, rest = (
        [value for value, _ in coverage_cells(found[name])]
        for name in ("explorer", "ideal", "exact", "rest")
    )
    unseen = [f"{100.0 - value:.1f} %" for value in device]
    gains = [f"{true - own:+.1f}" for true, own in zip(exact, device, strict=True)]
    ends = ", ".join(f"{time:g} s" for time in TIMES)
    left, still, more = ", ".join(unseen), f"{rest[-1]:.1f} %", ", ".join(gains)
    lost = f"{100.0 - ideal[0]:.2f} %"
    return f"""**Distance to the ideal policy.** At {ends} the planner with the observations
of a device leaves {left} of the wall unseen; the ideal policy leaves {lost} at the first of these
times. The magnet at rest sees {still} at the last. True pose and exact distances change the
planner's coverage by {more} percentage points. Not simulated: motion of the stomach, mucus and
bubbles in the image, a depth network, the delay of a robot, errors of the magnet's model, and a
tracker that loses the capsule."""


if __name__ == "__main__":
    main()
