"""Real organs, read once for all tests and workers."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface


@pytest.fixture(scope="session")
def real_organ(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], OrganSurface]:
    """Organ of a mesh in millimeters, by its file's name."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    @cache
    def organ(name: str) -> OrganSurface:
        kept = folder / f"{name}.pickle"
        if not kept.exists():
            found = read_organ(shared_data / "organs" / f"{name}.ply", unit="mm")
            own = kept.with_suffix(f".{os.getpid()}")
            own.write_bytes(pickle.dumps(found))
            own.replace(kept)
        return pickle.loads(kept.read_bytes())

    return organ
