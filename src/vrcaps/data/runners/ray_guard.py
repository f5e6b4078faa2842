"""Watchdog program: end the processes of a Ray cluster when the process that started it is killed.

Reads the cluster's token from standard input, which is closed when that process ends; a second
line confirms that the cluster was shut down. Ray's workers notice the end of their cluster only
when a task returns control to the interpreter or, during start-up, after a minute.

Runs as a script with the standard library only, so that it starts immediately.
"""

import contextlib
import os
import signal
import sys
import time
from pathlib import Path

_ROUNDS = 20
_PAUSE = 0.05
"""Interval between searches for processes that were just starting [s]."""


def end_processes(token: str) -> int:
    """Kill the processes with a token in their environment; return their number."""
    count = 0
    for path in Path("/proc").iterdir():
        if path.name.isdigit() and int(path.name) != os.getpid():
            with contextlib.suppress(OSError):  # of another user, or already ended
                variables = (path / "environ").read_bytes().split(b"\0")
                if f"RAY_AUTH_TOKEN={token}".encode() in variables:
                    os.kill(int(path.name), signal.SIGKILL)
                    count += 1
    return count


def main() -> None:
    """Wait, then kill if the cluster was not shut down."""
    for signal_id in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_id, signal.SIG_IGN)  # Ctrl-C is for the watched process
    token = sys.stdin.readline().strip()
    if not token or sys.stdin.readline():
        return
    for _ in range(_ROUNDS):
        end_processes(token)
        time.sleep(_PAUSE)


if __name__ == "__main__":
    main()
