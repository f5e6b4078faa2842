"""Results that test workers share: one worker makes each, the others read it from a file."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import pytest

from tests.support.waiting import wait_until
from vrcaps.core.processes import try_lock

Made = TypeVar("Made")


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Temporary folder of a run, the same for all its workers."""
    folder = factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[], Made]) -> Made:
    """Object that `make` returns, from the file `name` if a worker has written it.

    Each call returns a copy.
    """
    path = shared_folder(factory) / f"{name}.pickle"
    with one_worker(path.with_suffix(".lock")):
        if not path.exists():
            partial = path.with_suffix(".partial")
            partial.write_bytes(pickle.dumps(make()))
            partial.rename(path)
        return pickle.loads(path.read_bytes())


@contextmanager
def one_worker(lock: Path) -> Iterator[None]:
    """Block that one process executes at a time; the test fails if its turn never comes."""

    def is_locked() -> bool:
        try:
            try_lock(file.fileno())
        except OSError:
            return False
        return True

    with lock.open("w") as file:
        wait_until(is_locked)
        yield
