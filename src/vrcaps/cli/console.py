"""What the verbs print with: one console, one style of progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

# Wrapping is left to the terminal, so that a path can be copied whole; tables still fit its width.
console = Console(highlight=False, markup=False, soft_wrap=True)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on stderr, driven by the number done and the total; none in a log file.

    Args:
        title: What is being done.
    """
    from rich.progress import MofNCompleteColumn

    with _progress(MofNCompleteColumn()) as progress:
        task = progress.add_task(title, total=None)
        yield lambda num_done, total: progress.update(task, completed=num_done, total=total)


@contextmanager
def progress_bars(
    counted: str, timed: str
) -> Iterator[tuple[Callable[[int, int], None], Callable[[float, float], None]]]:
    """A bar of things done, and one of simulated time that shows when it is first driven.

    Args:
        counted: What is being done, driven by the number done and the total.
        timed: What is being simulated, driven by the time so far and the whole [s].
    """
    from rich.progress import TextColumn

    with _progress(TextColumn("{task.fields[done]}")) as progress:
        second = progress.add_task(timed, total=None, visible=False, done="")
        first = progress.add_task(counted, total=None, done="")

        def count(num_done: int, total: int) -> None:
            done = f"{num_done}/{total}"
            progress.update(first, completed=num_done, total=total, done=done)

        def pass_time(time: float, whole: float) -> None:
            done = f"{time:.1f}/{whole:.1f} s"
            progress.update(second, completed=time, total=whole, done=done, visible=True)

        yield count, pass_time


def _progress(amount: ProgressColumn) -> Progress:
    """Bars on stderr that vanish when all is done; none in a log file."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    errors = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), amount, TimeRemainingColumn())
    return Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal)
