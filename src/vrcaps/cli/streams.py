"""Handling of standard streams that are closed, broken, full, or lack characters."""

from __future__ import annotations

import os
import sys

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
