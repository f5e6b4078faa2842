"""Make a data set: a runner processes its units, each exactly once."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from vrcaps.core.build_info import made_here
from vrcaps.core.errors import StorageError, require
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.data.card import write_card
from vrcaps.data.ledger import (
    complete_units,
    enter_failure,
    failures,
    forget_failure,
    require_same_plan,
)
from vrcaps.data.make_unit import Job, Outcome
from vrcaps.data.plan import Plan
from vrcaps.data.runners.local import Pool, Runner
from vrcaps.data.store import Store, open_store, tidy_staging
from vrcaps.data.units import Units, check_plan


@dataclass(frozen=True)
class Made:
    """Result of a run.

    Attributes:
        made: Units that were recorded in this run.
        present: Units that were already complete.
        failed: Names of failed units, with the reason.
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
    progress: ProgressReport = no_report,
    source: str = "PLAN",
) -> Made:
    """Record the incomplete units of a plan; the same plan gives the same bytes.

    The data card is written when all units are complete.

    Args:
        plan: Plan to make.
        url: Folder or URL of the data set: new, or of an earlier run of this plan.
        numbers: Units to make; None makes all.
        runner: Runner of the units; None uses one process per processor.
        progress: Called with the number of finished units and of all requested ones.
        source: Name of the plan on the command line, for the command that reproduces a failure.

    Raises:
        InputError: If the plan may draw an invalid scenario, the store contains other files, or an
            index is out of range.
        StorageError: If the store cannot be written or reached; its complete files are kept.
    """
    units, store = Units(plan), open_store(url)
    chosen = range(len(units)) if numbers is None else numbers
    for index in chosen:
        require(0 <= index < len(units), "A unit", index, f"0 to {len(units) - 1}")
    check_plan(units)
    require_same_plan(store, plan)
    complete = set(complete_units(store, [units.name(index) for index in chosen]))
    missing = [index for index in chosen if units.name(index) not in complete]
    job = Job(plan, store.url, Path.cwd(), source, made_here())
    present, failed, earlier = len(chosen) - len(missing), {}, set(failures(store))
    with closing((runner or Pool()).run(job, missing)) as outcomes:
        for done, outcome in enumerate(outcomes, present + 1):
            name = units.name(outcome.index)
            if outcome.fault is not None:
                failed[name] = outcome.fault
            if outcome.fault is not None or name in earlier:
                _note(store, name, outcome, job)
            progress(done, len(chosen))
    if len(complete_units(store)) + len(failures(store)) == len(units):
        write_card(store)
    tidy_staging(store)
    return Made(len(missing) - len(failed), present, failed)


def _note(store: Store, name: str, outcome: Outcome, job: Job) -> None:
    """Enter the failure of a unit in the ledger, or remove the entry of an earlier one.

    Raises:
        StorageError: If no other unit can be made either.
    """
    if outcome.fault is None:
        forget_failure(store, name)
        return
    if outcome.stops_all:
        raise StorageError(outcome.fault)
    enter_failure(store, name, outcome.index, outcome.fault, job.command(outcome.index))
