"""Worker processes that end with the process that started them."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import wait
from typing import Any

_PR_SET_PDEATHSIG = 1


class _EndsWithParent:
    """Value that calls `kill_with_parent` when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[[int], None], tuple[int]]:
        return kill_with_parent, (os.getpid(),)


def spawned(target: Callable[..., None], *arguments: Any) -> Any:
    """Create a `multiprocessing` process, not started, that ends with this one in any case.

    Args:
        target: Function to run.
        arguments: Arguments of the function.
    """
    context = multiprocessing.get_context("spawn")
    # Unpickled in this order: the process must not outlive its parent while it imports packages.
    work = (_EndsWithParent(), target, arguments)
    return context.Process(target=_run, args=work, daemon=True)


def _run(_: None, target: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    end_with_parent()
    target(*arguments)


def end_with_parent() -> None:
    """End this `multiprocessing` process as soon as its parent has ended, in any way.

    On Linux the kernel kills it. On other systems a thread waits for the end of the parent and acts
    once compiled code releases the interpreter.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None and parent.pid is not None
    kill_with_parent(parent.pid)
    threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def kill_with_parent(parent: int) -> None:
    """Ask the kernel to kill this process when its parent ends; no effect on other systems.

    Args:
        parent: Process ID of the parent, which may have ended already.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def _exit_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
