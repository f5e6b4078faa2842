"""Timing that stands up to a busy machine: subjects take turns, ratios are made turn by turn."""

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
    """Something to be timed.

    Attributes:
        name: How it is called in tables.
        frame: Makes the frame of view i; everything is computed when it returns.
        note: What to know when reading its time.
    """

    name: str
    frame: Callable[[int], object]
    note: str = ""


@dataclass(frozen=True)
class Spread:
    """Median of a measure over all rounds and how far it scatters."""

    median: float
    p10: float
    p90: float

    @classmethod
    def of(cls, values: Float[np.ndarray, " rounds"]) -> Spread:
        """Spread of one value a round."""
        return cls(*(float(value) for value in np.percentile(values, (50.0, 10.0, 90.0))))

    def scaled(self, factor: float) -> Spread:
        """The same in another unit."""
        return Spread(self.median * factor, self.p10 * factor, self.p90 * factor)


@dataclass(frozen=True)
class Times:
    """Mean time of a frame in each round.

    Attributes:
        wall: On the clock [s].
        cpu: Of all threads of the process together [s]; other programs do not disturb it, but
            threads that wait by spinning count.
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
    """Time subjects in turns, so that a drift of the machine hits all of them alike.

    In each round every subject has one turn: a frame that is not timed, to bring its data back
    into the caches and its threads back to work, then one frame of each view. Each round starts
    with another subject. One round before the first is not counted.

    Args:
        subjects: What to time; names differ.
        num_views: Views of which a turn renders one frame each.
        num_rounds: Rounds that count.
        progress: Called after each round.

    Returns:
        Times by name, rounds in the same order for all.
    """
    wall = np.empty((num_rounds + 1, len(subjects)))
    cpu = np.empty_like(wall)
    for turn in range(num_rounds + 1):
        for k in np.roll(np.arange(len(subjects)), turn):
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
    """Time of one subject over that of another, made round by round."""
    return Spread.of(above.wall / below.wall)
