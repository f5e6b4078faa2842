"""Make a data set: record its units with several processes, each exactly once."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from vrcaps.data.card import write_card
from vrcaps.data.ledger import (
    EPISODES,
    enter,
    enter_failure,
    entry_of,
    failures,
    require_same_plan,
    whole_units,
)
from vrcaps.data.organs import organ_entry, store_organ
from vrcaps.data.plan import Plan, plan_to_plain
from vrcaps.data.store import Store, open_store
from vrcaps.data.units import Units
from vrcaps.errors import VrcapsError, require
from vrcaps.organ.cache import passing_organs

_ATTEMPTS = 3
"""Times that a unit may kill its worker before it counts as failed."""


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
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    source: str = "PLAN",
) -> Made:
    """Record the units of a plan that are not whole yet; the same plan gives the same bytes.

    When none is left to be made, the data card is written.

    Args:
        plan: What to make.
        url: Folder or URL of the data set: new, or this plan's own from before.
        numbers: Units to make; None makes all.
        workers: Processes; None takes one for each processor. 0 makes all in this one.
        progress: Called with the number of units done and of all that are asked for.
        source: How the command line named the plan, for the line that repeats a failed unit.

    Raises:
        InputError: If the store holds something else, or a number is of no unit.
    """
    units, store = Units(plan), open_store(url)
    chosen = range(len(units)) if numbers is None else numbers
    for number in chosen:
        require(0 <= number < len(units), "A unit", number, f"0 to {len(units) - 1}")
    require_same_plan(store, plan_to_plain(plan))
    whole = set(whole_units(store))
    missing = [number for number in chosen if units.name(number) not in whole]
    job = Job(plan, str(url), source)
    count = min(os.cpu_count() or 1 if workers is None else workers, len(missing))
    here = ((number, attempt(units, store, number)) for number in missing)
    results = _Pool(job, missing, count) if count else here
    done = len(chosen) - len(missing)
    failed: dict[str, str] = {}
    for number, message in results:
        done += 1
        if message is not None:
            name = units.name(number)
            failed[name] = message
            enter_failure(store, name, number, message, job.command(number))
        if progress is not None:
            progress(done, len(chosen))
    if len(whole_units(store)) + len(failures(store)) == len(units):
        write_card(store)
    return Made(len(missing) - len(failed), len(chosen) - len(missing), failed)


@dataclass(frozen=True)
class Job:
    """What every worker needs to know.

    Attributes:
        plan: The plan.
        url: Of the store.
        source: How the command line named the plan.
    """

    plan: Plan
    url: str
    source: str

    def command(self, number: int) -> str:
        """The line that makes one unit again."""
        return (
            f"vrcaps dataset make {self.source} --out {self.url} --units {number}:{number + 1} "
            "--workers 0"
        )


def make_unit(units: Units, store: Store, number: int) -> None:
    """Record one unit and commit it.

    Raises:
        VrcapsError: If it cannot be made.
        OSError: If it cannot be written.
    """
    from vrcaps.recording.recorder import record

    unit = units[number]
    with tempfile.TemporaryDirectory(prefix="vrcaps-") as scratch:
        folder = store.staging(unit.name, Path(scratch))
        folder.parent.mkdir(parents=True, exist_ok=True)
        # One that was broken off goes on where it stopped.
        with passing_organs():
            record(unit.scenario, folder, store_organ=partial(store_organ, store))
        entry = entry_of(unit, folder) | {"organ": organ_entry(store, folder)}
        store.put(folder, f"{EPISODES}/{unit.name}")
        enter(store, unit, entry)


def attempt(units: Units, store: Store, number: int) -> str | None:
    """Make a unit; why it cannot be made, if so."""
    try:
        make_unit(units, store, number)
    except (VrcapsError, OSError) as error:
        return str(error)
    return None


def _work(job: Job, connection: Connection, threads: int) -> None:
    """A worker: makes the units that it is told until it is told none."""
    os.environ["RAYON_NUM_THREADS"] = str(threads)
    units, store = Units(job.plan), open_store(job.url)
    with suppress(EOFError, BrokenPipeError):
        while (number := connection.recv()) is not None:
            connection.send((number, attempt(units, store, number)))


class _Pool:
    """Processes that make units; one that dies is replaced, and its unit is made again."""

    def __init__(self, job: Job, missing: Sequence[int], workers: int) -> None:
        self._job, self._queue = job, deque(missing)
        self._deaths: dict[int, int] = {}
        self._context = multiprocessing.get_context("spawn")
        self._threads = max(1, (os.cpu_count() or 1) // workers)
        self._busy: dict[Connection, tuple[Any, int]] = {}
        self._workers = workers

    def __iter__(self) -> Any:
        try:
            for _ in range(self._workers):
                self._start()
            while self._busy:
                for connection in wait(list(self._busy)):
                    assert isinstance(connection, Connection)
                    yield from self._answer(connection)
        finally:
            for process, _ in self._busy.values():
                process.terminate()

    def _start(self) -> None:
        """A new process with the next unit, if there is one."""
        if not self._queue:
            return
        ours, theirs = self._context.Pipe()
        arguments = (self._job, theirs, self._threads)
        process = self._context.Process(target=_work, args=arguments, daemon=True)
        process.start()
        theirs.close()
        self._give(ours, process)

    def _give(self, connection: Connection, process: Any) -> None:
        number = self._queue.popleft()
        self._busy[connection] = (process, number)
        with suppress(BrokenPipeError):  # it has died; `wait` will tell
            connection.send(number)

    def _answer(self, connection: Connection) -> Any:
        process, number = self._busy.pop(connection)
        try:
            yield connection.recv()
        except (EOFError, ConnectionResetError):
            yield from self._bury(process, number)
            return
        if self._queue:
            self._give(connection, process)
            return
        with suppress(BrokenPipeError):
            connection.send(None)
        process.join()

    def _bury(self, process: Any, number: int) -> Any:
        """A worker has died: its unit is tried again by another, but not for ever."""
        process.join()
        self._deaths[number] = self._deaths.get(number, 0) + 1
        if self._deaths[number] < _ATTEMPTS:
            self._queue.appendleft(number)
        else:
            yield number, f"Its worker died {_ATTEMPTS} times, last with {process.exitcode}."
        self._start()
