"""Program that ends the processes of a Ray cluster when the process that started it is killed.

Reads the cluster's token from standard input, whose end comes with the end of that process; a
second line says that the cluster was shut down. Ray's own workers notice the end of their cluster
when a task gives the interpreter back, or, while they start, after a minute.

Runs by itself, with the standard library alone, so that it is there at once.
"""

import contextlib
import os
import signal
import sys
import time
from pathlib import Path

_ROUNDS = 20
_PAUSE = 0.05
"""Between looks for processes that were just being started [s]."""


def end_processes(token: str) -> int:
    """Kill the processes with a token in their environment; how many were found."""
    found = 0
    for path in Path("/proc").iterdir():
        if path.name.isdigit() and int(path.name) != os.getpid():
            with contextlib.suppress(OSError):  # of another user, or ended meanwhile
                variables = (path / "environ").read_bytes().split(b"\0")
                if f"RAY_AUTH_TOKEN={token}".encode() in variables:
                    os.kill(int(path.name), signal.SIGKILL)
                    found += 1
    return found


def main() -> None:
    """Wait, then kill if the cluster was not shut down."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # Ctrl-C is for the process that is watched
    token = sys.stdin.readline().strip()
    if not token or sys.stdin.readline():
        return
    for _ in range(_ROUNDS):
        end_processes(token)
        time.sleep(_PAUSE)


if __name__ == "__main__":
    main()
