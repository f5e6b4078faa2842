"""Units made in this process, one after the other."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

from vrcaps.data.make_unit import Job, Maker, Outcome


@dataclass(frozen=True)
class InProcess:
    """Makes units in this process; a fault of vrcaps itself is raised with its traceback."""

    def run(self, job: Job, numbers: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units in their order."""
        maker = Maker(job)
        for number in numbers:
            yield maker.make(number)
