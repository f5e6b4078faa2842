"""Runner with a pool of processes on this machine; dead processes are replaced."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from vrcaps.core.processes import spawned
from vrcaps.data.make_unit import Job, Maker, Outcome
from vrcaps.data.runners.runner import Deaths, UnitQueue, num_processors
from vrcaps.data.units import Units


@dataclass(frozen=True)
class Pool:
    """Pool of processes that make units.

    Attributes:
        workers: Number of processes; None takes one for each processor.
    """

    workers: int | None = None

    def run(self, job: Job, numbers: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units; if a process dies, another retries its unit a limited number of times."""
        count = min(self.workers or num_processors(), len(numbers))
        run = _Run(job, numbers, count)
        try:
            yield from run.outcomes()
        finally:
            run.stop()


class _Run:
    """Running processes, each with its current unit."""

    def __init__(self, job: Job, numbers: Sequence[int], workers: int) -> None:
        self._queue = UnitQueue(numbers, Units(job.plan).per_patient)
        self._job, self._deaths = job, Deaths()
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
        number = self._queue.take(last)
        self._busy[connection] = (process, number)
        with suppress(BrokenPipeError):  # it has died; `wait` will report it
            connection.send(number)

    def _answer(self, connection: Connection) -> Iterator[Outcome]:
        process, number = self._busy[connection]
        try:
            outcome = connection.recv()
        except (EOFError, ConnectionResetError):
            del self._busy[connection]
            yield from self._bury(process, number)
            return
        del self._busy[connection]
        self._queue.end(number)
        if self._queue:
            self._give(connection, process, number)
        else:
            with suppress(BrokenPipeError):
                connection.send(None)
            process.join()
        yield outcome

    def _bury(self, process: Any, number: int) -> Iterator[Outcome]:
        """Handle the death of a process: a new one retries its unit."""
        process.join()
        self._queue.end(number)
        outcome = self._deaths.bury(number, f"exit code {process.exitcode}")
        if outcome is None:
            self._queue.put_back(number)
        self._start()
        if outcome is not None:
            yield outcome


def _work(job: Job, connection: Connection, threads: int) -> None:
    """Worker loop: make the received units until there are none."""
    os.environ.setdefault("RAYON_NUM_THREADS", str(threads))
    maker = Maker(job)
    with suppress(EOFError, BrokenPipeError, KeyboardInterrupt):
        while (number := connection.recv()) is not None:
            connection.send(maker.make_always(number))
