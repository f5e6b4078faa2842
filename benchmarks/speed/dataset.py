"""Claim: the time per unit of a data set is that of its recording and independent of its size.

Measured on this machine: recordings of two frames by pools of 1 and 2 processes, the time of the
head for each unit, and entering and asking for units in ledgers of 1,000 to 100,000. Simulated from
these: 100 workers with a processor each, for these short units and for units of a minute.

    python -m benchmarks.speed.dataset [--size UNITS]
"""

from __future__ import annotations

import contextlib
import heapq
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps.data.ledger import complete_units, enter, is_complete
from vrcaps.data.make_unit import Job, Maker
from vrcaps.data.plan import DatasetSettings, Plan, read_plan
from vrcaps.data.runners.local import Pool
from vrcaps.data.store import LocalStore
from vrcaps.data.units import Units

LEDGERS = (1_000, 10_000, 100_000)
FILES = 1_500
"""Files of an entry: 300 frames of five channels."""
LONG = 60.0
"""Time of a long unit [s]."""
COHORT = {
    "organ": {"name": {"choice": ["colon", "stomach"]}},
    "lesions": {"prevalence": 1.0},
    "motion": {"speed": {"uniform": [0.005, 0.02]}},
}
SEED = 0


@dataclass(frozen=True)
class Times:
    """Measured times [s].

    Attributes:
        units: Of each unit in one process.
        start: From the start of a pool of one to its first unit, without that unit.
        head: Of the head's processor, for each unit.
        pools: Of each unit by pools of 1 and 2 processes, start left out.
    """

    units: np.ndarray
    start: float
    head: float
    pools: tuple[float, float]


def main() -> None:
    """Measure, simulate, write the tables."""
    from tests.support.tiny_dataset import write_tiny_plan

    given = options(__doc__ or "", size=60)
    with tempfile.TemporaryDirectory(prefix="vrcaps-scale-") as name:
        folder = Path(name)
        times = measure(write_tiny_plan(folder, given.size), folder)
        ledgers = [ledger_row(folder / str(count), count) for count in LEDGERS]
    median = float(np.median(times.units))
    rows = [
        [str(k), "measured", f"{median:.2f} s", f"{1.0 / t:.1f}", f"{median / t / k:.0%}", ""]
        for k, t in enumerate(times.pools, 1)
    ]
    for workers, scale in ((1, 1.0), (2, 1.0), (100, 1.0), (100, LONG / median)):
        rate, busy = simulated(times, workers, scale)
        unit = scale * median
        shown = f"{unit:.2f} s" if scale == 1.0 else f"{unit:.0f} s"
        share = f"{rate * unit / workers:.0%}"
        rows.append([str(workers), "simulated", shown, f"{rate:.3g}", share, f"{busy:.2%}"])
    head = ("workers", "", "per unit", "units per second", "of the ideal", "head at work")
    text = f"""## Scaling of dataset generation

{given.size} recordings of two frames of 40 × 36 pixels, one thread each. The head needs
{1e3 * times.head:.2f} ms of a processor for a unit (its outcome is received, and the next one
sent), so it serves at most {1.0 / times.head:,.0f} units per second: {median / times.head:,.0f}
workers with units as short as these. The first unit ends {times.start:.1f} s later than it would
take alone: a process starts and loads its modules. The simulation: each worker has a processor, its
units take the measured times (scaled for long ones), the head serves one outcome after the other,
100 units a worker. The ideal is the rate of the workers without a head. The limit is the recording
itself; two processes on this machine share its memory and its files.

{table(head, rows)}

Work done once for each unit or each run, by the number of units that are there; an entry of
{FILES:,} files:

{table(("units in the ledger", "enter one", "ask for one", "list all"), ledgers)}

{plan_text()}
"""
    write_section(given.out, Path(__file__), text)


def measure(plan_file: Path, folder: Path) -> Times:
    """Make the data set in this process and by pools; in the last run all units are complete."""
    plan, units = read_plan(plan_file), []
    maker = Maker(Job(plan, str(folder / "here"), folder))
    numbers = range(len(Units(plan)))
    with contextlib.chdir(folder):  # from which paths in the plan lead
        maker.make(0)  # loads what is loaded once
        for number in numbers[1:]:
            began = time.perf_counter()
            maker.make(number)
            units.append(time.perf_counter() - began)
        pools, starts = [], []
        for workers in (1, 2):
            job = Job(plan, str(folder / f"pool-{workers}"), folder)
            began = time.perf_counter()
            ends = [time.perf_counter() for _ in Pool(workers).run(job, numbers)]
            pools.append((ends[-1] - ends[workers - 1]) / (len(numbers) - workers))
            starts.append(ends[0] - began)
        # All units are whole: workers answer at once, and what is left is the head's.
        many = [*numbers] * 20
        began = time.process_time()
        for _ in Pool(1).run(job, many):
            pass
        head = (time.process_time() - began) / len(many)
    return Times(np.array(units), starts[0] - float(np.median(units)), head, (pools[0], pools[1]))


def simulated(times: Times, workers: int, scale: float) -> tuple[float, float]:
    """Units per second, and the fraction of the time in which the head works.

    Args:
        times: As measured.
        workers: Number of workers, each with a processor.
        scale: Factor on the time of a unit.
    """
    draw, count = np.random.default_rng(SEED), 100 * workers
    durations = scale * draw.choice(times.units, count)
    running = [(times.start + float(durations[k]), k) for k in range(workers)]
    heapq.heapify(running)
    free = last = 0.0
    given_out = workers
    while running:
        at, worker = heapq.heappop(running)
        free = last = max(free, at) + times.head
        if given_out < count:
            heapq.heappush(running, (free + durations[given_out], worker))
            given_out += 1
    return count / (last - times.start), count * times.head / (last - times.start)


def ledger_row(folder: Path, count: int) -> list[str]:
    """Cost of a ledger of some units: to enter one, to look up one, to list all."""
    (folder / "ledger").mkdir(parents=True)
    for number in range(count):
        (folder / "ledger" / f"p00000-{number:06d}.json").touch()
    store = LocalStore(folder)
    units = Units(Plan(DatasetSettings("scale", patients=10), {}))
    files = {f"front/rgb/{k:06d}.png": "0" * 64 for k in range(FILES)}
    entry = {"number": 0, "files": files}
    costs = (
        _median(lambda k: enter(store, units[k], entry), range(10)),
        _median(lambda k: is_complete(store, f"p00000-{k:06d}"), range(100)),
        _median(lambda _: complete_units(store), range(5)),
    )
    return [f"{count:,}", *(f"{1e3 * cost:.3g} ms" for cost in costs)]


def plan_text() -> str:
    """Cost of a plan: a unit, and the splits of a large cohort."""
    settings = DatasetSettings("scale", patients=10_000, stratify=("organ.name",))
    units = Units(Plan(settings, COHORT))
    began = time.perf_counter()
    _ = units.splits
    splits = time.perf_counter() - began
    unit = _median(lambda k: units[k], range(0, 10_000, 500))
    return (
        f"A worker resolves a unit of the plan in {1e3 * unit:.1f} ms, and once the stratified "
        f"splits of\n10,000 patients in {splits:.1f} s."
    )


def _median(action: Callable[[int], object], arguments: Sequence[int]) -> float:
    costs = []
    for argument in arguments:
        began = time.perf_counter()
        action(argument)
        costs.append(time.perf_counter() - began)
    return float(np.median(costs))


if __name__ == "__main__":
    main()
