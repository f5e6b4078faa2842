"""Worker processes that end with their parent, locks that end with their process, prefetching."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import multiprocessing
import os
import platform
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, TypeVar

from vrcaps.core.errors import InputError, StorageError

MAX_WORKERS = 256
"""Maximum number of threads or processes that a user may request; far more hang the machine."""

_PR_SET_PDEATHSIG = 1

ProgressReport = Callable[[int, int], None]
"""Function that is called with the number of done items and the total."""


def no_report(done: int, total: int) -> None:
    """Ignore progress; the default of functions that report it."""


_Item = TypeVar("_Item")


def prefetch(items: Iterable[_Item]) -> Generator[_Item, None, None]:
    """Iterate over items while a thread computes the next one.

    The order and the errors are those of `items`. Closing the iterator waits for the item that is
    being computed.

    Args:
        items: Items that another thread may compute.
    """
    remaining = iter(items)

    def following() -> list[_Item]:
        return list(islice(remaining, 1))

    with ThreadPoolExecutor(1, thread_name_prefix="vrcaps-prefetch") as thread:
        pending = thread.submit(following)
        while computed := pending.result():
            pending = thread.submit(following)
            yield computed[0]


def once(function: Callable[[], _Item]) -> Callable[[], _Item]:
    """Function that calls another one the first time and then returns the same result.

    Several threads may call it; the others wait for the first.

    Args:
        function: Function without arguments; called again only if it raised an error.
    """
    lock, results = threading.Lock(), []

    def result() -> _Item:
        with lock:
            if not results:
                results.append(function())
            return results[0]

    return result


class _EndsWithParent:
    """Value that calls `kill_with_parent` when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[[int], None], tuple[int]]:
        return kill_with_parent, (os.getpid(),)


def spawned(target: Callable[..., None], *arguments: Any) -> Any:
    """Create a `multiprocessing` process, not yet started, that always ends with this one.

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


_HELD = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
_UNSUPPORTED = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


class FolderInUseError(InputError):
    """A folder that another process is writing to."""


@contextmanager
def file_lock(path: Path, what: str) -> Iterator[None]:
    """Hold a lock file, which is created with its folder and removed after the block.

    The operating system releases the lock when its process ends in any way, so the file of a
    killed process locks nothing. The file names the process that holds it.

    Args:
        path: The file.
        what: Output that the lock protects, for messages.

    Raises:
        FolderInUseError: If another process or thread holds it.
        StorageError: If it cannot be created.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _acquire(path, what)
    except OSError as error:
        raise StorageError(f"Cannot write {what}: {error}.") from error
    try:
        yield
    finally:
        _release(file, path)


def _acquire(path: Path, what: str) -> int:
    """Open and lock the file.

    Raises:
        FolderInUseError: If another process holds it.
        OSError: If it cannot be created.
    """
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    while True:
        file = os.open(path, flags, 0o666)
        try:
            _require_lock(file)
            is_own = path.exists() and os.path.samestat(os.fstat(file), path.stat())
        except OSError as error:
            os.close(file)
            if error.errno not in _HELD:
                raise
            raise FolderInUseError(
                f"{_holder(path)} is writing {what}. Wait until it finishes or give another folder."
            ) from error
        if is_own:
            break
        os.close(file)  # of a recorder that has just ended and removed its file
    os.ftruncate(file, 0)
    os.write(file, json.dumps({"pid": os.getpid(), "host": platform.node()}).encode())
    return file


def _release(file: int, path: Path) -> None:
    """Remove the file while it is locked; on Windows, which keeps open files, after closing it."""
    with contextlib.suppress(OSError):
        if sys.platform != "win32":
            path.unlink()
        os.close(file)
        if sys.platform == "win32":
            path.unlink()


def try_lock(file: int) -> bool:
    """Lock an open file until it is closed, without waiting.

    Returns:
        True if it is locked now, False if the file system has no locks.

    Raises:
        OSError: If another process or thread holds it.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(file, 1 << 30, os.SEEK_SET)  # beyond the text, which others read
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
            os.lseek(file, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        return False
    return True


def _require_lock(file: int) -> None:
    """Lock an open file; warn if the file system has no locks.

    Raises:
        OSError: If another process or thread holds it.
    """
    if not try_lock(file):
        warnings.warn(
            "The file system of the output folder has no locks: do not start a second command "
            "that writes into it.",
            stacklevel=2,
        )


def _holder(path: Path) -> str:
    """Process that wrote the lock, for messages."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        return f"Process {held['pid']} on {held['host']}"
    except (OSError, ValueError, LookupError, TypeError):
        return "Another process"
