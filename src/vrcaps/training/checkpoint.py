"""Progress of a training, and the checkpoint from which it resumes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from vrcaps.core.errors import InputError

PROGRESS = "progress.csv"
"""File of the rows of the progress, written before each checkpoint, which completes the state."""


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        step: Number of completed steps: batches of a network, rounds of a policy.
        total: Total number of steps.
        rows: A row of statistics for each evaluation of a network, each round of a policy.
        best: Best value of the metric that selects the best weights; None before the first.
    """

    step: int
    total: int
    rows: tuple[dict[str, float], ...] = ()
    best: float | None = None


class Training(Protocol):
    """A training that can be interrupted between steps."""

    @property
    def progress(self) -> Progress:
        """Progress so far."""
        ...

    def advance(self) -> None:
        """Run one step, and the evaluation and the checkpoint that are due after it."""
        ...


def run_training(training: Training, report: Callable[[Progress], None]) -> Progress:
    """Run all remaining steps of a training.

    Args:
        training: The training.
        report: Called before the first and after each step.
    """
    report(training.progress)
    while training.progress.step < training.progress.total:
        training.advance()
        report(training.progress)
    return training.progress


@contextmanager
def restoring(path: Path) -> Iterator[None]:
    """Convert any error in restoring a checkpoint to one line.

    Errors of PyTorch for damaged files and states have no common base.

    Raises:
        InputError: If the block raises any exception.
    """
    try:
        yield
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path} is damaged ({reason}). Give a new folder.") from error
