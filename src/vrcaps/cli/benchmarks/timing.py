"""Timing that is robust on a busy machine: subjects alternate, ratios are computed per round."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Subject:
    """Function to be timed.

    Attributes:
        name: Name in tables.
        frame: Computes the frame of view i; all work is complete when it returns.
        note: Note on its time.
    """

    name: str
    frame: Callable[[int], object]
    note: str = ""


@dataclass(frozen=True)
class Spread:
    """Median of a measure over all rounds, and its spread."""

    median: float
    p10: float
    p90: float

    @classmethod
    def of(cls, values: Float[np.ndarray, " rounds"]) -> Spread:
        """Spread of one value per round."""
        return cls(*(float(value) for value in np.percentile(values, (50.0, 10.0, 90.0))))

    def scaled(self, factor: float) -> Spread:
        """Convert to another unit."""
        return Spread(self.median * factor, self.p10 * factor, self.p90 * factor)


@dataclass(frozen=True)
class Times:
    """Mean time of a frame in each round.

    Attributes:
        wall: Wall-clock time [s].
        cpu: CPU time of all threads of the process [s]; other programs do not affect it, but
            spinning threads count.
    """

    wall: Float[np.ndarray, " rounds"]
    cpu: Float[np.ndarray, " rounds"]


def interleave(
    subjects: Sequence[Subject],
    *,
    num_views: int,
    num_rounds: int,
    progress: Callable[[], None] | None = None,
) -> dict[str, Times]:
    """Time subjects in alternation, so that drift of the machine affects all of them equally.

    In each round every subject has one turn: an untimed frame, to warm its caches and threads, then
    one frame of each view. Each round starts with another subject. An extra first round is not
    counted.

    Args:
        subjects: Subjects with distinct names.
        num_views: Number of views; a turn renders one frame of each.
        num_rounds: Number of counted rounds.
        progress: Called after each round.

    Returns:
        Times by name, with rounds in the same order for all.
    """
    wall = np.empty((num_rounds + 1, len(subjects)))
    cpu = np.empty_like(wall)
    for turn in range(num_rounds + 1):
        for position in range(len(subjects)):
            k = (position + turn) % len(subjects)
            wall[turn, k], cpu[turn, k] = _turn(subjects[k], num_views)
        if progress is not None:
            progress()
    return {
        subject.name: Times(wall[1:, k] / num_views, cpu[1:, k] / num_views)
        for k, subject in enumerate(subjects)
    }


def _turn(subject: Subject, num_views: int) -> tuple[float, float]:
    subject.frame(num_views - 1)
    cpu, wall = time.process_time(), time.perf_counter()
    for view in range(num_views):
        subject.frame(view)
    return time.perf_counter() - wall, time.process_time() - cpu


def ratio(above: Times, below: Times) -> Spread:
    """Ratio of the times of two subjects, computed per round."""
    return Spread.of(above.wall / below.wall)
