"""Server of `tests.support.programs`: it loads packages once and runs each program in a fork.

It reads one JSON object per line from standard input and writes the exit status of each program.
No package of the project is loaded before the fork, so a program imports vrcaps afresh. A job with
`"loaded": true` is a fork of a child that has imported vrcaps too.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import json
import os
import runpy
import signal
import sys
import threading
import traceback
import types
import warnings
from collections.abc import Callable
from typing import Any, TextIO

PACKAGES = (
    "numpy",
    "pytest",
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
    "torch._inductor.config",
    "segmentation_models_pytorch",
    "timm",
    "gymnasium",
)
"""Packages that programs import; what is not installed is left out."""
VRCAPS = (
    "vrcaps.cli.record",
    "vrcaps.data",
    "vrcaps.env",
    "vrcaps.formats",
    "vrcaps.learn",
    "vrcaps.policy",
)
"""Packages of the project that programs import, besides the public names."""


def load() -> None:
    """Import the packages of others; garbage collection of a fork leaves them out."""
    gc.disable()
    os.environ["MPLBACKEND"] = "agg"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in PACKAGES:
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
    loaded = sorted(name for name in sys.modules if name.partition(".")[0] == "vrcaps")
    assert not loaded, loaded
    gc.collect()
    gc.freeze()
    gc.enable()


def load_vrcaps() -> None:
    """Import the public names of vrcaps and its commands."""
    sys.path[:0] = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    vrcaps = importlib.import_module("vrcaps")
    for name in vrcaps.__all__:
        getattr(vrcaps, name)
    for name in VRCAPS:
        importlib.import_module(name)
    gc.collect()
    gc.freeze()


def run(job: dict[str, Any]) -> int:
    """Run a program like the interpreter; return its exit status."""
    signal.alarm(int(job["timeout"]))
    os.chdir(job["folder"])
    os.environ.clear()
    os.environ.update(job["environment"])
    given = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    sys.path[:] = list(dict.fromkeys([*given, *sys.path]))
    sys.argv = job["arguments"]
    try:
        exec(job["setup"], {})
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
            if "stdout" in job:
                redirect(job["stdout"], job["stderr"])
            status = run(job)
        finally:
            end(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def redirect(stdout: str, stderr: str) -> None:
    """Send both streams to files; nothing is read."""
    for path, stream in ((stdout, 1), (stderr, 2)):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, stream)
        os.close(file)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)


def end(status: int) -> None:
    """Leave a child as the interpreter does: join threads, call exit functions, flush."""
    with contextlib.suppress(BaseException):
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def serve(jobs: TextIO, answers: TextIO) -> None:
    """Answer until there are no more jobs."""
    loaded = None
    for line in jobs:
        job = json.loads(line)
        if job.pop("loaded", False):
            loaded = loaded or Child(load_vrcaps)
            status = loaded.answer(job)
        else:
            status = fork(job)
        answers.write(f"{status}\n")
        answers.flush()


class Child:
    """Server in a fork of this process, for a program that starts others."""

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        """Fork; call it before packages of the project are loaded and threads are started.

        Args:
            prepare: Function that the child calls before its first program.
        """
        jobs, answers = os.pipe(), os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            os.close(jobs[1])
            with os.fdopen(jobs[0]) as given, os.fdopen(answers[1], "w") as told:
                prepare()
                serve(given, told)
            os._exit(0)
        os.close(jobs[0])
        os.close(answers[1])
        self._jobs, self._answers = os.fdopen(jobs[1], "w"), os.fdopen(answers[0])
        atexit.register(self._stop)
        os.register_at_fork(after_in_child=lambda: atexit.unregister(self._stop))

    def run(self, code: str, *arguments: str, setup: str, timeout: float) -> int:
        """Run code with the folder, environment and streams of this process; its exit status."""
        job = {
            "code": code,
            "arguments": ["-c", *arguments],
            "folder": os.getcwd(),
            "environment": dict(os.environ),
            "warnings": "",
            "setup": setup,
            "timeout": timeout,
        }
        return self.answer(job)

    def answer(self, job: dict[str, Any]) -> int:
        """Exit status of a program."""
        self._jobs.write(f"{json.dumps(job)}\n")
        self._jobs.flush()
        return int(self._answers.readline())

    def _stop(self) -> None:
        self._jobs.close()
        os.waitpid(self._pid, 0)


def main() -> None:
    """Load packages, then answer until standard input ends."""
    load()
    serve(sys.stdin, sys.stdout)
    gc.unfreeze()  # for the exit


if __name__ == "__main__":
    main()
