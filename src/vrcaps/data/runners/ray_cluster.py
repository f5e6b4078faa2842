"""Runner on a Ray cluster, existing or started on this machine."""

from __future__ import annotations

import logging
import os
import secrets
import socket
import subprocess
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, import_extra
from vrcaps.data.make_unit import Job, Maker, Outcome
from vrcaps.data.runners.local import UnitQueue, WorkerDeaths, num_processors
from vrcaps.data.units import Units

LOCAL, AUTO = "local", "auto"

_POLL = 2.0
"""Interval between checks that the head node still answers [s]."""

_CONNECT = 5.0
"""Timeout of the head node [s]."""

_OBJECT_STORE = 80 * 2**20
"""Object store of a local cluster, for the plan and the outcomes [bytes]."""


@dataclass(frozen=True)
class RayCluster:
    """Workers of a Ray cluster, one processor each.

    Attributes:
        address: `local` starts a cluster on this machine and stops it at the end; `auto` joins the
            cluster of this machine; ``HOST:PORT`` is the address of the head node.
        workers: Number of concurrent units; None runs one per processor of the cluster.
    """

    address: str
    workers: int | None = None

    def __post_init__(self) -> None:
        host, _, port = self.address.rpartition(":")
        is_address = bool(host) and "/" not in host and port.isdigit() and 0 < int(port) < 2**16
        if self.address not in (LOCAL, AUTO) and not is_address:
            raise InputError(
                f"The address of Ray is {self.address!r}. Allowed: {LOCAL}, {AUTO} or HOST:PORT, "
                "from a machine of the cluster."
            )

    def run(self, job: Job, indices: Sequence[int]) -> Generator[Outcome, None, None]:
        """Make units; if a worker dies, another retries its unit a limited number of times."""
        if not indices:
            return
        ray = import_extra("ray", "scale")
        with _connected(ray, self) as head:
            yield from _outcomes(ray, job, indices, self.workers, head)


@contextmanager
def _connected(ray: Any, cluster: RayCluster) -> Iterator[str]:
    """Connect to a cluster; yields the address of its head node.

    Raises:
        InputError: If there is no such cluster.
    """
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if cluster.address == LOCAL:
        # Starts without usage reports.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options |= {
            "num_cpus": cluster.workers or num_processors(),
            "include_dashboard": False,
            "object_store_memory": _OBJECT_STORE,
            "_node_ip_address": "127.0.0.1",
            # Otherwise this process would wait forever if the first worker died during its start.
            "_system_config": {"prestart_worker_first_driver": False},
        }
    with _own_token() if cluster.address == LOCAL else nullcontext():
        try:
            if cluster.address != LOCAL:
                _require_head(cluster.address)
            ray.init(cluster.address, **options)
        except (ConnectionError, RuntimeError) as error:
            reason = str(error).splitlines()[0].rstrip(".") + "."
            raise InputError(
                f"Cannot join the Ray cluster {cluster.address!r} from this machine: {reason} "
                "Start one with `ray start --head` (if it has a token: set RAY_AUTH_MODE=token), "
                f"or give --ray {LOCAL}."
            ) from error
        try:
            yield ray.get_runtime_context().gcs_address
        finally:
            ray.shutdown()


@contextmanager
def _guarded(token: str) -> Iterator[None]:
    """End the cluster of a token if this process is killed in this block (Linux)."""
    if sys.platform != "linux":  # elsewhere Ray has such a program itself
        yield
        return
    environment = {name: v for name, v in os.environ.items() if name != "RAY_AUTH_TOKEN"}
    command = [sys.executable, "-I", "-S", str(Path(__file__).with_name("ray_guard.py"))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, text=True) as guard:
        assert guard.stdin is not None
        guard.stdin.write(f"{token}\n")
        guard.stdin.flush()
        try:
            yield
        finally:
            with suppress(OSError):  # it was killed
                guard.stdin.write("done\n")
                guard.stdin.close()


@contextmanager
def _own_token() -> Iterator[None]:
    """Require this process's token for connections to clusters started in this block.

    A client of a cluster can run code in it, and any process of the machine can reach its ports.
    The token is passed in the environment, which other users cannot read; by default Ray stores
    it in a file of the home folder, which they can.
    """
    from ray._raylet import (
        AuthenticationTokenLoader,  # pyright: ignore[reportAttributeAccessIssue]
        Config,  # pyright: ignore[reportAttributeAccessIssue]
    )

    names = ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")
    before = {name: os.environ.pop(name) for name in names if name in os.environ}
    token = secrets.token_hex(32)
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": token}
    try:
        AuthenticationTokenLoader.instance().reset_cache()
        Config.initialize("")
        with _guarded(token):
            yield
    finally:
        for name in names:
            os.environ.pop(name, None)
        os.environ |= before
        Config.initialize("")  # first: Ray threads still shutting down would miss the token
        AuthenticationTokenLoader.instance().reset_cache()


def _require_head(address: str) -> None:
    """Check that the head node answers; Ray itself would wait for minutes.

    Raises:
        InputError: If it does not.
        ConnectionError: If this machine does not belong to a cluster.
    """
    from ray._private.services import canonicalize_bootstrap_address

    head = canonicalize_bootstrap_address(address) if address == AUTO else address
    if head is None or not _answers(head):
        raise InputError(
            f"No Ray head answers at {head}. Start one with `ray start --head`, or give "
            f"--ray {LOCAL}."
        )


def _outcomes(
    ray: Any, job: Job, indices: Sequence[int], workers: int | None, head: str
) -> Iterator[Outcome]:
    """Outcomes of units, as many concurrent ones as there are processors.

    Raises:
        InputError: If the cluster is lost or cannot run vrcaps.
    """
    max_running = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
    task = ray.remote(num_cpus=1, max_retries=0)(_make)
    # In a tuple the reference is not resolved: the worker fetches the job if it lacks it.
    shared, deaths = (ray.put(job),), WorkerDeaths()
    queue = UnitQueue(indices, Units(job.plan).per_patient)
    running: dict[Any, int] = {}
    asked = time.monotonic()
    while queue or running:
        while queue and len(running) < max_running:
            index = queue.take()
            running[task.remote(shared, index)] = index
        ended, _ = ray.wait(list(running), timeout=_POLL)
        if time.monotonic() > asked + _POLL:
            if not _answers(head):
                raise InputError(_lost(head, "does not answer"))
            asked = time.monotonic()
        for reference in ended:
            index = running.pop(reference)
            queue.end(index)
            outcome = _outcome(ray, reference, index, deaths, head)
            if outcome is None:
                queue.put_back(index)
            else:
                yield outcome


def _outcome(
    ray: Any, reference: Any, index: int, deaths: WorkerDeaths, head: str
) -> Outcome | None:
    """Outcome of a finished task; None if its unit is retried."""
    try:
        return ray.get(reference)
    except ray.exceptions.LocalRayletDiedError as error:
        raise InputError(_lost(head, "has died")) from error
    except ray.exceptions.RayTaskError as error:
        reason = str(error).strip().splitlines()[-1]
        raise InputError(
            f"A Ray worker cannot run vrcaps: {reason}. Every machine of the cluster needs the "
            "same version of vrcaps, and the folder in which this command was given."
        ) from error
    except ray.exceptions.RayError as error:
        # The worker or its machine died, or it took too much memory.
        return deaths.count(index, type(error).__name__)


def _lost(head: str, how: str) -> str:
    return (
        f"The Ray head at {head} {how}. Completed recordings are kept. Restart it, or give "
        f"--ray {LOCAL}, and repeat the command to resume."
    )


def _answers(address: str) -> bool:
    """Return whether an address accepts connections."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_CONNECT).close()
    except OSError:
        return False
    return True


def _make(shared: tuple[Any], index: int) -> Outcome:
    """Remote task: make a unit in a worker of the cluster, on one processor.

    Args:
        shared: Reference to the job.
        index: Index of the unit.
    """
    os.environ.setdefault("RAYON_NUM_THREADS", "1")
    return _maker(*shared).make_always(index)


@lru_cache(maxsize=1)
def _maker(reference: Any) -> Maker:
    """Maker of a job, one per worker, because resolving a large plan is slow."""
    import ray

    job: Any = ray.get(reference)
    os.chdir(job.folder)
    return Maker(job)
