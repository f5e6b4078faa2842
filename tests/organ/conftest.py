"""Real organs, read once for all tests and workers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.support.once import made_once
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface


@pytest.fixture(scope="session")
def real_organ(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], OrganSurface]:
    """Organ of a mesh in millimeters, by its file's name."""

    @cache
    def organ(name: str) -> OrganSurface:
        path = shared_data / "organs" / f"{name}.ply"
        return made_once(tmp_path_factory, name, lambda: read_organ(path, unit="mm"))

    return organ
