"""The protocol of what runs units, and how often a unit is tried."""

from __future__ import annotations

import os
from collections import Counter
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
