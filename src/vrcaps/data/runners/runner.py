"""Runner protocol, order of the units, and number of retries."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Generator, Sequence
from typing import Protocol

from vrcaps.data.make_unit import Job, Outcome

_MOST = 3
"""Maximum number of workers that a unit may kill before it counts as failed."""


class Runner(Protocol):
    """Runner of units."""

    def run(self, job: Job, numbers: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units; yields one outcome for each, in the order of completion.

        Running units are stopped when the iterator is closed.

        Args:
            job: Job of the units.
            numbers: Indices of the units.

        Raises:
            VrcapsError: If units cannot be run at all.
        """
        ...


def num_processors() -> int:
    """Number of processors available to this process; a cluster job has only some of a machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class UnitQueue:
    """Queue of units that assigns each worker its own patients.

    The first recording of a patient generates the organ, which is slow, and the others read it from
    the cache; two workers that start with the same patient would both generate it.
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
        number = self._waiting[patient].popleft()
        if not self._waiting[patient]:
            del self._waiting[patient]
        self._running[patient] += 1
        return number

    def end(self, number: int) -> None:
        """Mark a unit as no longer assigned to a worker."""
        patient = number // self._per_patient
        self._running[patient] -= 1
        if not self._running[patient]:
            del self._running[patient]

    def put_back(self, number: int) -> None:
        """Requeue a unit that has ended, before all others of its patient."""
        self._waiting.setdefault(number // self._per_patient, deque()).appendleft(number)


class Deaths:
    """Number of workers that died while making each unit."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def bury(self, number: int, how: str) -> Outcome | None:
        """Count a death; return the outcome if the unit is not retried.

        Args:
            number: Index of the unit.
            how: Cause of death, for the message.
        """
        self._counts[number] += 1
        if self._counts[number] < _MOST:
            return None
        return Outcome(number, f"Its worker died {_MOST} times, last with {how}.")
