"""Runner in this process, one unit after the other."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

from vrcaps.data.make_unit import Job, Maker, Outcome


@dataclass(frozen=True)
class InProcess:
    """Make units in this process; internal errors of vrcaps are raised with their traceback."""

    def run(self, job: Job, numbers: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units in order."""
        maker = Maker(job)
        for number in numbers:
            yield maker.make(number)
