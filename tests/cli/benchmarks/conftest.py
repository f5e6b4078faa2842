from __future__ import annotations

import pytest

from vrcaps.cli.benchmarks.stage import Stage, make_organ, make_stage


@pytest.fixture(scope="session")
def stage() -> Stage:
    return make_stage(make_organ(20_000, seed=1), num_views=3)
