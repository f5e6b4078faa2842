"""Python programs in separate processes, without the start-up time of heavy packages.

A server imports the packages of others (PyTorch, SciPy, ...) once for each test worker; a program
is a fork of it and imports vrcaps afresh, unless its claim is of work after the import. Environment
variables of the program apply to vrcaps and its core; those that a package of others reads at its
import, such as `OPENBLAS_NUM_THREADS`, need `subprocess`, as does a test of start-up.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from tests.support import program_server
from tests.support.waiting import WATCHDOG


def run_program(
    program: Path | str,
    *arguments: str,
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
    warnings: str = "",
    setup: str = "",
    is_loaded: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Run a Python program to its end.

    Args:
        program: File, or the code itself.
        arguments: Arguments of the program.
        folder: Working directory; the current one if None.
        environment: Environment variables that are added to those of this process.
        warnings: Regular expression of modules whose warnings are errors, for a file.
        setup: Statements that run before the program.
        is_loaded: Whether vrcaps has been imported before, with the environment of this process.

    Returns:
        Exit status (negative for a signal, SIGALRM for a hang), and both streams as text.
    """
    is_file = isinstance(program, Path)
    with tempfile.TemporaryDirectory() as streams:
        stdout, stderr = Path(streams, "stdout"), Path(streams, "stderr")
        job = {
            "code": None if is_file else program,
            "arguments": [str(program) if is_file else "-c", *arguments],
            "folder": str(folder or Path.cwd()),
            "environment": {**os.environ, **(environment or {})},
            "warnings": warnings,
            "setup": setup,
            "loaded": is_loaded,
            "timeout": WATCHDOG,
            "stdout": str(stdout),
            "stderr": str(stderr),
        }
        server = _server()
        assert server.stdin is not None and server.stdout is not None
        print(json.dumps(job), file=server.stdin, flush=True)
        status = int(server.stdout.readline())
        return subprocess.CompletedProcess(
            job["arguments"], status, stdout.read_text("utf-8"), stderr.read_text("utf-8")
        )


@cache
def _server() -> subprocess.Popen[str]:
    """The server of this test process, started on first use."""
    command = [sys.executable, "-P", program_server.__file__]
    pipe = subprocess.PIPE
    server = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, encoding="utf-8")
    atexit.register(_stop, server)
    return server


def _stop(server: subprocess.Popen[str]) -> None:
    """End the server; its standard input is then at its end."""
    server.communicate(timeout=WATCHDOG)
