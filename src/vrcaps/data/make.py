"""Make a data set: its units are run by whatever runs them, and each counts exactly once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from vrcaps.data.card import write_card
from vrcaps.data.check_plan import check_plan
from vrcaps.data.ledger import (
    enter_failure,
    failures,
    forget_failure,
    require_same_plan,
    whole_units,
)
from vrcaps.data.make_unit import Job, Outcome
from vrcaps.data.plan import Plan
from vrcaps.data.runners.pool import Pool
from vrcaps.data.runners.runner import Runner
from vrcaps.data.store import open_store, tidy_staging
from vrcaps.data.units import Units
from vrcaps.errors import StorageError, require
from vrcaps.made_with import made_here


@dataclass(frozen=True)
class Made:
    """What a run did.

    Attributes:
        made: Units that were recorded now.
        present: Units that were whole before.
        failed: Names of units that could not be made, with the reason.
    """

    made: int
    present: int
    failed: dict[str, str]


def make_dataset(
    plan: Plan,
    url: str | Path,
    *,
    numbers: Sequence[int] | None = None,
    runner: Runner | None = None,
    progress: Callable[[int, int], None] | None = None,
    source: str = "PLAN",
) -> Made:
    """Record the units of a plan that are not whole yet; the same plan gives the same bytes.

    When none is left to be made, the data card is written.

    Args:
        plan: What to make.
        url: Folder or URL of the data set: new, or this plan's own from before.
        numbers: Units to make; None makes all.
        runner: What runs the units; None takes a process for each processor.
        progress: Called with the number of units done and of all that are asked for.
        source: How the command line named the plan, for the line that repeats a failed unit.

    Raises:
        InputError: If the plan may draw what is no scenario, the store holds something else, or a
            number is of no unit.
        StorageError: If the place cannot be written or reached; what is whole there stays whole.
    """
    units, store = Units(plan), open_store(url)
    chosen = range(len(units)) if numbers is None else numbers
    for number in chosen:
        require(0 <= number < len(units), "A unit", number, f"0 to {len(units) - 1}")
    check_plan(units)
    require_same_plan(store, plan)
    whole = set(whole_units(store, [units.name(number) for number in chosen]))
    missing = [number for number in chosen if units.name(number) not in whole]
    job = Job(plan, store.url, Path.cwd(), source, made_here())
    before, failed = set(failures(store)), {}
    done = len(chosen) - len(missing)
    with closing((runner or Pool()).run(job, missing)) as outcomes:
        for outcome in outcomes:
            done += 1
            name = units.name(outcome.number)
            if outcome.fault is not None:
                failed[name] = _noted(outcome)
                enter_failure(
                    store, name, outcome.number, outcome.fault, job.command(outcome.number)
                )
            elif name in before:
                forget_failure(store, name)
            if progress is not None:
                progress(done, len(chosen))
    if len(whole_units(store)) + len(failures(store)) == len(units):
        write_card(store)
    tidy_staging(store)
    return Made(len(missing) - len(failed), len(chosen) - len(missing), failed)


def _noted(outcome: Outcome) -> str:
    """Why a unit could not be made.

    Raises:
        StorageError: If no other can be made either.
    """
    assert outcome.fault is not None
    if outcome.stops_all:
        raise StorageError(outcome.fault)
    return outcome.fault
