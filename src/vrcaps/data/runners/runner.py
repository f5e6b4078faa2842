"""The protocol of what runs units, in which order they are run, and how often each is tried."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Generator, Sequence
from typing import Protocol

from vrcaps.data.make_unit import Job, Outcome

_MOST = 3
"""Times that a unit may kill its worker before it counts as failed."""


class Runner(Protocol):
    """What runs units."""

    def run(self, job: Job, numbers: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units; gives one outcome for each, in the order in which they end.

        What still runs is ended when the iterator is closed.

        Args:
            job: What they are units of.
            numbers: Of the units.

        Raises:
            VrcapsError: If units cannot be run at all.
        """
        ...


def num_processors() -> int:
    """Processors that this process may use; a job of a cluster has some of its machine's."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class UnitQueue:
    """Units that wait for a worker, so that workers are with patients of their own.

    The first recording of a patient makes the organ, which takes long, and the others find it in
    the cache; two workers that begin with the same patient would both make it.
    """

    def __init__(self, numbers: Sequence[int], per_patient: int) -> None:
        self._per_patient = per_patient
        self._waiting: dict[int, deque[int]] = {}
        for number in numbers:
            self._waiting.setdefault(number // per_patient, deque()).append(number)
        self._running: Counter[int] = Counter()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self, last: int | None = None) -> int:
        """The next unit for a worker.

        It is of the worker's last patient, else of the first one that no worker is with, else of
        the first.

        Args:
            last: Unit that the worker made before.
        """
        patient = None if last is None else last // self._per_patient
        if patient not in self._waiting:
            free = (p for p in self._waiting if not self._running[p])
            patient = next(free, next(iter(self._waiting)))
        number = self._waiting[patient].popleft()
        if not self._waiting[patient]:
            del self._waiting[patient]
        self._running[patient] += 1
        return number

    def end(self, number: int) -> None:
        """A unit is no longer with a worker."""
        patient = number // self._per_patient
        self._running[patient] -= 1
        if not self._running[patient]:
            del self._running[patient]

    def put_back(self, number: int) -> None:
        """A unit that has ended waits again, before all others of its patient."""
        self._waiting.setdefault(number // self._per_patient, deque()).appendleft(number)


class Deaths:
    """Workers that died while they made a unit, counted by unit."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def bury(self, number: int, how: str) -> Outcome | None:
        """Count a death; the outcome if the unit is not to be tried again.

        Args:
            number: Of the unit.
            how: How the worker died, for the message.
        """
        self._counts[number] += 1
        if self._counts[number] < _MOST:
            return None
        return Outcome(number, f"Its worker died {_MOST} times, last with {how}.")
