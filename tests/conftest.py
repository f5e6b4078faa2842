"""Fixtures shared by all tests."""

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.coarse_organs import fill_cache, patch_looks
from tests.support.once import one_worker, shared_folder
from vrcaps import _core

_ROOT = str(Path(__file__).parents[1])
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (_ROOT, os.environ.get("PYTHONPATH"))))
"""Search path of processes that tests start: it includes `tests.support` and `benchmarks`."""

sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
"""Bytecode is kept: workers and hundreds of programs would compile all their imports."""

if "PYTEST_XDIST_WORKER" in os.environ:  # workers run beside each other, so each takes one thread
    for _threads in ("RAYON", "OIDN", "OMP", "OPENBLAS"):
        os.environ.setdefault(f"{_threads}_NUM_THREADS", "1")

gc.disable()  # until all tests are collected; what is loaded by then stays
_core.testing.forbid_global_pool()
"""All parallel work runs in the pool of the core that a forked process makes again: what goes
another way panics."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Optional real test data beside the checkout."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not path.is_dir():
        pytest.skip(f"optional test data not found at {path}")
    return path


@pytest.fixture(scope="session")
def coarse_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cache folder with coarse organs, the same for all workers."""
    folder = shared_folder(tmp_path_factory) / "coarse-organs"
    with one_worker(folder.with_suffix(".lock")):
        if not folder.exists():
            partial = folder.with_suffix(".partial")
            fill_cache(partial)
            partial.rename(folder)
    return folder


@pytest.fixture(scope="module")
def coarse_organs(coarse_cache: Path) -> Iterator[None]:
    """Organs, textures and images of the catalog are coarse, in programs of a test too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VRCAPS_CACHE", str(coarse_cache))
        patch_looks(patch)
        yield


def pytest_collection_finish() -> None:
    """Leave modules and collected tests out of garbage collection, which is also rarer.

    It takes a tenth of the processor time of the tests otherwise.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    """Let modules be collected at the exit."""
    gc.unfreeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests with real data are slow."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
