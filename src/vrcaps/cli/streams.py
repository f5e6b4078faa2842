"""Standard streams as they may be: closed, broken, full, or unable to show some characters."""

from __future__ import annotations

import os
import sys

EXIT_BROKEN_PIPE = 141
"""Status of a program that SIGPIPE ends, in a shell."""


def configure_streams() -> None:
    """Open closed streams as the null device, and replace characters that a terminal lacks."""
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            # Held open: a file that is opened later must not take the place of the closed one.
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif name != "stdin" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def flush_output() -> None:
    """Write what is left of the output.

    Raises:
        SystemExit: If nobody reads it, or it cannot be written.
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
    """Send what is left of the output nowhere, so that the interpreter can end."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)
