"""Worker processes end with their head, also in compiled code that keeps the interpreter."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes import command_of
from tests.support.waiting import wait_until
from vrcaps.core import processes

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a thread needs the interpreter"),
]

HEAD = """
import ctypes, multiprocessing, os
from concurrent.futures import ProcessPoolExecutor
from vrcaps.core.processes import end_with_parent, spawned

def hang(*_):
    os.write(1, f"{os.getpid()}\\n".encode())
    ctypes.PyDLL(None).pause()  # keeps the interpreter: no thread of Python runs

class HangsAtImport:
    def __reduce__(self):
        return hang, ()

def started():
    process = spawned(hang)
    process.start()
    process.join()

def importing():
    process = spawned(print, HangsAtImport())
    process.start()
    process.join()

def pool():
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, initializer=end_with_parent) as workers:
        workers.submit(hang).result()

if __name__ == "__main__":
    KIND()
"""


@pytest.mark.parametrize("kind", ["started", "importing", "pool"])
def test_a_worker_ends_when_its_head_is_killed(kind: str, tmp_path: Path) -> None:
    script = tmp_path / "head.py"
    script.write_text(HEAD.replace("KIND", kind))
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE) as head:
        assert head.stdout is not None
        worker = int(head.stdout.readline())
        assert "multiprocessing" in command_of(worker)
        head.kill()
    wait_until(lambda: command_of(worker) == "")


def test_a_process_whose_parent_has_ended_before_ends_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The parent may end while its child starts, before the kernel is asked."""

    def exit_with(code: int) -> None:
        raise SystemExit(code)

    monkeypatch.setattr(processes.ctypes, "CDLL", lambda _: processes.threading)
    monkeypatch.setattr(processes.threading, "prctl", lambda *_: 0, raising=False)
    monkeypatch.setattr(processes.os, "_exit", exit_with)
    processes.kill_with_parent(processes.os.getppid())
    with pytest.raises(SystemExit):
        processes.kill_with_parent(-1)
