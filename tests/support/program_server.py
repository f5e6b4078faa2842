"""Server of `tests.support.programs`: it loads packages once and runs each program in a fork.

It reads one JSON object per line from standard input and writes the exit status of each program.
No package of the project is loaded before the fork, so a program imports vrcaps afresh.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import importlib
import json
import os
import runpy
import sys
import threading
import traceback
import types
import warnings
from typing import Any, TextIO

PACKAGES = (
    "numpy",
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse.linalg",
    "scipy.spatial",
    "trimesh",
    "skimage.measure",
    "PIL.Image",
    "av",
    "pyarrow.parquet",
    "matplotlib.figure",
    "rich.console",
    "tyro",
    "cattrs",
    "torch",
    "gymnasium",
)
"""Packages that programs import; what is not installed is left out."""


WATCHDOG = 900.0
"""As `tests.support.waiting`, which this process does not import."""


def load() -> None:
    """Import the packages of others."""
    os.environ["MPLBACKEND"] = "agg"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in PACKAGES:
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
    loaded = sorted(name for name in sys.modules if name.partition(".")[0] == "vrcaps")
    assert not loaded, loaded


def run(job: dict[str, Any]) -> int:
    """Run a program like the interpreter; return its exit status."""
    faulthandler.dump_traceback_later(job["timeout"], exit=True)
    os.chdir(job["folder"])
    os.environ.clear()
    os.environ.update(job["environment"])
    given = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    sys.path[:] = list(dict.fromkeys([*given, *sys.path]))
    sys.argv = job["arguments"]
    try:
        if job["code"] is None:
            sys.path.insert(0, os.path.dirname(sys.argv[0]))
            if job["warnings"]:
                warnings.filterwarnings("error", module=job["warnings"])
            runpy.run_path(sys.argv[0], run_name="__main__")
        else:
            sys.path.insert(0, "")
            module = types.ModuleType("__main__")
            sys.modules["__main__"] = module
            exec(compile(job["code"], "<string>", "exec"), module.__dict__)
    except SystemExit as error:
        if isinstance(error.code, str):
            sys.stderr.write(f"{error.code}\n")
            return 1
        return error.code or 0
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def fork(job: dict[str, Any]) -> int:
    """Exit status of a program in a child process; negative for a signal."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            redirect(job["stdout"], job["stderr"])
            status = run(job)
        finally:
            end(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def redirect(stdout: str, stderr: str) -> None:
    """Send both streams to files, unless their names are empty; nothing is read."""
    for path, stream in ((stdout, 1), (stderr, 2)):
        if path:
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, stream)
            os.close(file)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)


class Branch:
    """Server in a fork of a program that has imported nothing yet, for the programs it starts."""

    def __init__(self) -> None:
        """Fork; the child answers until this process ends."""
        jobs, self._jobs = os.pipe()
        self._statuses, statuses = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            os.close(self._jobs)
            with open(jobs) as given, open(statuses, "w") as out:
                answer(given, out)
            os._exit(0)
        atexit.register(self.close)
        os.close(jobs)
        os.close(statuses)

    def close(self) -> None:
        """End the child."""
        os.close(self._jobs)
        os.waitpid(self._child, 0)

    def run(self, code: str, *arguments: str) -> int:
        """Exit status of a program in the current folder, with the streams of this process."""
        job = {
            "code": code,
            "arguments": ["-c", *arguments],
            "folder": os.getcwd(),
            "environment": dict(os.environ),
            "timeout": WATCHDOG,
            "stdout": "",
            "stderr": "",
        }
        sys.stdout.flush()
        os.write(self._jobs, f"{json.dumps(job)}\n".encode())
        status = b""
        while not status.endswith(b"\n"):
            status += os.read(self._statuses, 64)
        return int(status)


def end(status: int) -> None:
    """Leave a child as the interpreter does: join threads, call exit functions, flush."""
    with contextlib.suppress(BaseException):
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def answer(jobs: TextIO, statuses: TextIO) -> None:
    """Run the programs of a stream to its end and write their exit statuses."""
    for line in jobs:
        statuses.write(f"{fork(json.loads(line))}\n")
        statuses.flush()


def main() -> None:
    """Answer until standard input ends."""
    load()
    answer(sys.stdin, sys.stdout)


if __name__ == "__main__":
    main()
