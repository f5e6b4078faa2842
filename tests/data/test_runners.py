"""Runners of units: a pool and a Ray cluster, whose processes are killed; refused settings."""

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.failing import fail
from tests.support.processes import command_of, descendants
from tests.support.waiting import WATCHDOG, wait_until
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.data.ledger import complete_units
from vrcaps.data.make import make_dataset
from vrcaps.data.make_unit import Job, Maker, Outcome
from vrcaps.data.plan import read_plan
from vrcaps.data.runners import ray_guard
from vrcaps.data.runners.local import InProcess, Pool, UnitQueue, WorkerDeaths
from vrcaps.data.runners.ray_cluster import RayCluster
from vrcaps.data.store import LocalStore

KILLED_HEAD = """
import os, signal, sys
from tests.support.processes import descendants
from vrcaps.data.make import make_dataset
from vrcaps.data.plan import read_plan
from vrcaps.data.runners.local import Pool

def kill(done, total):
    print(*descendants(os.getpid()), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    make_dataset(read_plan(sys.argv[1]), sys.argv[2], runner=Pool(1), progress=kill)
"""


def files(folder: Path) -> dict[str, bytes]:
    paths = (p for p in folder.rglob("*") if p.is_file() and ".staging" not in p.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def kill_one(head: int, word: str) -> bool:
    """SIGKILL the first process below another whose command holds a word."""
    for pid in descendants(head):
        if word in command_of(pid):
            os.kill(pid, signal.SIGKILL)
            return True
    return False


def kill_soon(head: int, word: str) -> None:
    """SIGKILL the first such process as soon as there is one."""
    wait_until(lambda: kill_one(head, word))


def once(action: Callable[[], object]) -> Callable[[int, int], object]:
    """A report of progress that does something when the first unit is whole."""
    waiting = [action]
    return lambda *_: waiting.pop()() if waiting else None


@pytest.mark.slow
def test_a_pool_goes_on_after_kills(whole: Path, plan_file: Path, tmp_path: Path) -> None:
    """The head is killed after a unit, and its worker ends with it; then a worker of the next."""
    out, script = tmp_path / "pool", tmp_path / "run.py"
    script.write_text(KILLED_HEAD)
    command = [sys.executable, script, plan_file, out]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as head:
        below = [int(pid) for pid in head.communicate(timeout=WATCHDOG)[0].split()]
    assert head.returncode == -signal.SIGKILL
    assert below
    wait_until(lambda: not any(map(command_of, below)))
    num_made, killed = len(complete_units(LocalStore(out))), []
    assert 0 < num_made < 8
    kill_worker = once(lambda: killed.append(kill_one(os.getpid(), "spawn_main")))
    made = make_dataset(read_plan(plan_file), out, runner=Pool(1), progress=kill_worker)
    assert killed == [True]
    assert (made.made, made.present, made.failed) == (8 - num_made, num_made, {})
    assert files(out) == files(whole)


def _has_raylet(head: int) -> bool:
    return any("raylet" in command_of(pid) for pid in descendants(head))


@pytest.fixture(scope="module")
def ray_head() -> Iterator[tuple[subprocess.Popen, str]]:
    """A Ray cluster of one processor on this machine, and its address."""
    pytest.importorskip("ray", reason="ray is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = ["start", "--head", "--block", "--port", str(port), "--num-cpus", "1"]
    words += ["--node-ip-address", "127.0.0.1", "--include-dashboard", "false"]
    words += ["--object-store-memory", str(80 * 2**20), "--disable-usage-stats"]
    run = f"from ray.scripts.scripts import cli; cli({words!r})"
    process = subprocess.Popen(
        [sys.executable, "-c", run],
        env={**os.environ, "RAY_AUTH_MODE": "disabled"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wait_until(lambda: process.poll() is not None or _has_raylet(process.pid))
    assert process.poll() is None
    yield process, f"127.0.0.1:{port}"
    for pid in descendants(process.pid):
        os.kill(pid, signal.SIGKILL)
    process.kill()
    process.wait()


@pytest.mark.server
def test_ray_makes_the_same_bytes_and_tells_of_a_dead_head(
    whole: Path,
    plan_file: Path,
    tmp_path: Path,
    ray_head: tuple[subprocess.Popen, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A worker is killed, then the head; the same command goes on without it."""
    monkeypatch.setattr("vrcaps.data.runners.ray_cluster._POLL", 0.0)
    (process, address), plan = ray_head, read_plan(plan_file)
    killer = threading.Thread(target=kill_soon, args=(process.pid, "ray::_make"))
    killer.start()
    out, cluster = tmp_path / "ray", RayCluster(address)
    first = make_dataset(plan, out, runner=cluster, numbers=range(4))
    assert (first.made, first.failed) == (4, {})
    killer.join()
    kill_head = once(lambda: kill_one(process.pid, "gcs_server"))
    with pytest.raises(InputError, match=r"The Ray head at \S+ does not answer\. .* to resume\."):
        make_dataset(plan, out, runner=cluster, progress=kill_head)
    with pytest.raises(InputError, match=r"No Ray head answers at .* --ray local"):
        make_dataset(plan, out, runner=cluster)
    make_dataset(plan, out, runner=InProcess())
    assert files(out) == files(whole)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("is_shut_down", [False, True])
def test_processes_of_a_cluster_end_when_its_head_is_killed(is_shut_down: bool) -> None:
    """The end of its standard input tells the guard; other processes stay."""
    pause = [sys.executable, "-c", "import signal; signal.pause()"]
    token = "0123456789abcdef"
    worker, other = (
        subprocess.Popen(pause, env={**os.environ, "RAY_AUTH_TOKEN": value})
        for value in (token, token[:-1])
    )
    wait_until(lambda: command_of(worker.pid) and command_of(other.pid))
    try:
        said = f"{token}\ndone\n" if is_shut_down else f"{token}\n"
        subprocess.run([sys.executable, ray_guard.__file__], input=said, text=True, check=True)
        if is_shut_down:
            assert worker.poll() is None
        else:
            assert worker.wait() == -signal.SIGKILL
        assert other.poll() is None
    finally:
        for process in (worker, other):
            process.kill()
            process.wait()


def test_a_unit_that_kills_its_workers_counts_as_failed() -> None:
    deaths = WorkerDeaths()
    assert deaths.count(3, "exit code -9") is None
    assert deaths.count(4, "exit code -9") is None
    assert deaths.count(3, "exit code -9") is None
    outcome = deaths.count(3, "exit code -11")
    assert outcome == Outcome(3, "Its worker died 3 times, last with exit code -11.")


def test_workers_are_with_patients_of_their_own() -> None:
    queue = UnitQueue(range(9), 3)
    first, second = queue.take(), queue.take()
    assert (first, second) == (0, 3)
    queue.end(first)
    assert queue.take(first) == 1
    queue.end(second)
    queue.put_back(second)  # its worker has died
    assert queue.take() == 3
    assert queue.take() == 6
    assert queue.take() == 2  # all patients have a worker
    rest = [queue.take(4) for _ in range(4)]
    assert rest == [4, 5, 7, 8]
    assert not queue


def test_every_fault_of_a_unit_is_an_outcome(
    plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mistake of the plan concerns one unit, a full disk all, a fault of vrcaps one again."""
    maker = Maker(Job(read_plan(plan_file), str(tmp_path / "out"), tmp_path))

    def outcome(error: Exception) -> Outcome:
        def record(*_: object, **__: object) -> None:
            raise error

        monkeypatch.setattr("vrcaps.recording.recorder.record", record)
        return maker.make_always(1)

    assert outcome(InputError("told")) == Outcome(1, "told")
    assert outcome(OSError(28, "No space left")).stops_all
    assert outcome(ZeroDivisionError("by zero")) == Outcome(1, "ZeroDivisionError: by zero")
    with pytest.raises(ZeroDivisionError):
        maker.make(1)


@pytest.mark.parametrize("address", ["nonsense", "ray://host:10001", "host:99999", ":80"])
def test_addresses_that_are_none_are_refused(address: str) -> None:
    with pytest.raises(InputError, match=r"Allowed: local, auto or HOST:PORT"):
        RayCluster(address)


def test_without_ray_its_package_is_named(
    plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"ray is not installed.*vrcaps\[scale\]"):
        make_dataset(read_plan(plan_file), tmp_path / "out", runner=RayCluster("local"))
    words = ["dataset", "make", str(plan_file), "--out", str(tmp_path / "out")]
    assert "--workers is 0. Allowed: 1 to 256" in fail(
        [*words, "--ray", "local", "--workers", "0"], capsys
    )


def test_a_cluster_that_is_not_there_is_one_clear_line(
    plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where Ray remembers one that is gone: it would wait two minutes for it."""
    services = pytest.importorskip("ray._private.services", reason="ray is not installed")
    job = Job(read_plan(plan_file), "x", tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    message = r"No Ray head answers at \S+:\d+\. Start one with"
    with pytest.raises(InputError, match=message):
        list(RayCluster(f"127.0.0.1:{port}").run(job, [0]))
    monkeypatch.setattr(services, "find_gcs_addresses", set)
    monkeypatch.setattr(services, "find_bootstrap_address", lambda _: f"127.0.0.1:{port}")
    with pytest.raises(InputError, match=message):
        list(RayCluster("auto").run(job, [0]))
    monkeypatch.setattr(services, "find_bootstrap_address", lambda _: None)
    with pytest.raises(InputError, match=r"Cannot join the Ray cluster 'auto'.*--ray local\."):
        list(RayCluster("auto").run(job, [0]))
