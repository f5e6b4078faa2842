"""Runners on this machine: in this process, or in a pool whose dead processes are replaced."""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from vrcaps.core.processes import spawned
from vrcaps.data.make_unit import Job, Maker, Outcome
from vrcaps.data.units import Units

_MAX_DEATHS = 3
"""Maximum number of workers that a unit may kill before it counts as failed."""


class Runner(Protocol):
    """Runner of units."""

    def run(self, job: Job, indices: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units; yields one outcome for each, in the order of completion.

        Running units are stopped when the iterator is closed.

        Args:
            job: Job of the units.
            indices: Indices of the units.

        Raises:
            VrcapsError: If no unit can be run.
        """
        ...


def num_processors() -> int:
    """Number of processors available to this process; a cluster job may not have all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class UnitQueue:
    """Queue of units that assigns each worker its own patients.

    The first recording of a patient generates the organ, which is slow, and the others read it from
    the cache; two workers that start with the same patient would both generate it.
    """

    def __init__(self, indices: Sequence[int], per_patient: int) -> None:
        self._per_patient = per_patient
        self._waiting: dict[int, deque[int]] = {}
        for index in indices:
            self._waiting.setdefault(index // per_patient, deque()).append(index)
        self._running: Counter[int] = Counter()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self, last: int | None = None) -> int:
        """Return the next unit for a worker.

        Units of the worker's last patient come first, then those of the first patient without a
        worker, then all others.

        Args:
            last: Previous unit of the worker.
        """
        patient = None if last is None else last // self._per_patient
        if patient not in self._waiting:
            free = (p for p in self._waiting if not self._running[p])
            patient = next(free, next(iter(self._waiting)))
        index = self._waiting[patient].popleft()
        if not self._waiting[patient]:
            del self._waiting[patient]
        self._running[patient] += 1
        return index

    def end(self, index: int) -> None:
        """Mark a unit as no longer assigned to a worker."""
        patient = index // self._per_patient
        self._running[patient] -= 1
        if not self._running[patient]:
            del self._running[patient]

    def put_back(self, index: int) -> None:
        """Requeue a unit that has ended, before all others of its patient."""
        self._waiting.setdefault(index // self._per_patient, deque()).appendleft(index)


class WorkerDeaths:
    """Number of workers that died while making each unit."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def count(self, index: int, cause: str) -> Outcome | None:
        """Count a death; return the outcome if the unit is not retried.

        Args:
            index: Index of the unit.
            cause: Cause of death, for the message.
        """
        self._counts[index] += 1
        if self._counts[index] < _MAX_DEATHS:
            return None
        return Outcome(index, f"Its worker died {_MAX_DEATHS} times, last with {cause}.")


@dataclass(frozen=True)
class InProcess:
    """Make units in this process; internal errors of vrcaps are raised with their traceback."""

    def run(self, job: Job, indices: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units in order."""
        maker = Maker(job)
        for index in indices:
            yield maker.make(index)


@dataclass(frozen=True)
class Pool:
    """Pool of processes that make units.

    Attributes:
        workers: Number of processes; None takes one for each processor.
    """

    workers: int | None = None

    def run(self, job: Job, indices: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units; if a process dies, another retries its unit a limited number of times."""
        count = min(self.workers or num_processors(), len(indices))
        run = _Run(job, indices, count)
        try:
            yield from run.outcomes()
        finally:
            run.stop()


class _Run:
    """Running processes, each with its current unit."""

    def __init__(self, job: Job, indices: Sequence[int], workers: int) -> None:
        self._queue = UnitQueue(indices, Units(job.plan).per_patient)
        self._job, self._deaths = job, WorkerDeaths()
        self._threads = max(1, num_processors() // max(workers, 1))
        self._busy: dict[Connection, tuple[Any, int]] = {}
        self._workers = workers

    def outcomes(self) -> Iterator[Outcome]:
        for _ in range(self._workers):
            self._start()
        while self._busy:
            for connection in wait(list(self._busy)):
                assert isinstance(connection, Connection)
                yield from self._answer(connection)

    def stop(self) -> None:
        for process, _ in self._busy.values():
            process.terminate()
        for process, _ in self._busy.values():
            process.join()

    def _start(self) -> None:
        """Start a process with the next unit, if there is one."""
        if not self._queue:
            return
        ours, theirs = multiprocessing.Pipe()
        process = spawned(_work, self._job, theirs, self._threads)
        process.start()
        theirs.close()
        self._give(ours, process)

    def _give(self, connection: Connection, process: Any, last: int | None = None) -> None:
        index = self._queue.take(last)
        self._busy[connection] = (process, index)
        with suppress(BrokenPipeError):  # it has died; `wait` will report it
            connection.send(index)

    def _answer(self, connection: Connection) -> Iterator[Outcome]:
        process, index = self._busy[connection]
        try:
            outcome = connection.recv()
        except (EOFError, ConnectionResetError):
            del self._busy[connection]
            yield from self._replace(process, index)
            return
        del self._busy[connection]
        self._queue.end(index)
        if self._queue:
            self._give(connection, process, index)
        else:
            with suppress(BrokenPipeError):
                connection.send(None)
            process.join()
        yield outcome

    def _replace(self, process: Any, index: int) -> Iterator[Outcome]:
        """Handle the death of a process: a new one retries its unit."""
        process.join()
        self._queue.end(index)
        outcome = self._deaths.count(index, f"exit code {process.exitcode}")
        if outcome is None:
            self._queue.put_back(index)
        self._start()
        if outcome is not None:
            yield outcome


def _work(job: Job, connection: Connection, threads: int) -> None:
    """Worker loop: make the received units until there are none."""
    os.environ.setdefault("RAYON_NUM_THREADS", str(threads))
    maker = Maker(job)
    with suppress(EOFError, BrokenPipeError, KeyboardInterrupt):
        while (index := connection.recv()) is not None:
            connection.send(maker.make_always(index))
