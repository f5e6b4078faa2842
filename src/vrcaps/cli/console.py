"""Console of the command line: standard streams, and progress as bars or lines in a log file."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

    from vrcaps.core.processes import ProgressReport

EXIT_BROKEN_PIPE = 141
"""Exit status of a program ended by SIGPIPE, in a shell."""


def configure_streams() -> None:
    """Open closed streams as the null device, and replace characters that a terminal lacks."""
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # Kept open: a file that is opened later must not get the closed stream's descriptor.
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif name != "stdin" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def flush_output() -> None:
    """Flush the remaining output.

    Raises:
        SystemExit: If there is no reader, or the output cannot be written.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        discard_output()
        if isinstance(error, BrokenPipeError):
            raise SystemExit(EXIT_BROKEN_PIPE) from None
        sys.stderr.write(f"vrcaps: Cannot write the output: {error.strerror}.\n")
        raise SystemExit(1) from None


def discard_output() -> None:
    """Discard the remaining output, so that the interpreter can exit."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)


# Wrapping is left to the terminal, so that paths can be copied in one piece; tables fit its width.
console = Console(highlight=False, markup=False, soft_wrap=True)


PERIOD = 30.0
"""Minimum time between progress lines without a terminal [s]."""

_TICK = 1.0
"""Time between checks whether a line is due [s]."""


@contextmanager
def progress_bar(title: str) -> Iterator[ProgressReport]:
    """Progress bar on stderr, updated with the counts done and in total; lines in a log file.

    Args:
        title: Description of the task.
    """
    from rich.progress import MofNCompleteColumn

    with _progress(MofNCompleteColumn()) as progress:
        task, lines = progress.add_task(title, total=None), _Lines(title)

        def advance(num_done: int, total: int) -> None:
            progress.update(task, completed=num_done, total=total)
            lines.report(f"{num_done}/{total}")

        with lines.reporting():
            yield advance


@contextmanager
def progress_bars(
    counted: str, timed: str
) -> Iterator[tuple[ProgressReport, Callable[[float, float], None]]]:
    """Bar of counted items, and one of simulated time that appears when it is first updated.

    Args:
        counted: Description of the items, updated with the counts done and in total.
        timed: Description of the simulation, updated with the current and the total time [s].
    """
    from rich.progress import TextColumn

    with _progress(TextColumn("{task.fields[done]}")) as progress:
        second = progress.add_task(timed, total=None, visible=False, done="")
        first = progress.add_task(counted, total=None, done="")
        counts, times = _Lines(counted), _Lines(timed)

        def count(num_done: int, total: int) -> None:
            done = f"{num_done}/{total}"
            progress.update(first, completed=num_done, total=total, done=done)
            counts.report(done)

        def pass_time(time: float, whole: float) -> None:
            done = f"{time:.1f}/{whole:.1f} s"
            progress.update(second, completed=time, total=whole, done=done, visible=True)
            times.report(done)

        with counts.reporting():
            yield count, pass_time


class _Lines:
    """Progress lines on stderr, at most one per period, if stderr is not a terminal."""

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._title, self._clock = title, clock
        self._started = self._reported = clock()
        self._done = "none done"

    @contextmanager
    def reporting(self) -> Iterator[None]:
        """Write lines even without updates, such as while an organ is generated."""
        if sys.stderr.isatty():
            yield
            return
        ended = Event()

        def report_until_ended() -> None:
            while not ended.wait(_TICK):
                self.report(self._done)

        thread = Thread(target=report_until_ended, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def report(self, done: str) -> None:
        """Write a line if one is due."""
        self._done = done
        now = self._clock()
        if now - self._reported < PERIOD or sys.stderr.isatty():
            return
        self._reported = now
        sys.stderr.write(f"{self._title}: {done} after {now - self._started:.0f} s\n")
        sys.stderr.flush()


def _progress(amount: ProgressColumn) -> Progress:
    """Bars on stderr that disappear at the end; none in a log file."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    errors = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), amount, TimeRemainingColumn())
    return Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal)
