from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.once import made_once
from vrcaps.anatomy.colon import ColonParameters, generate_colon
from vrcaps.cli.benchmarks.stage import QUICK, Stage, make_stage
from vrcaps.organ.surface import Appearance


@pytest.fixture(scope="session")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    """A coarse colon with a small texture: baking the full one takes longer than all tests."""
    parameters = ColonParameters(triangles=QUICK.num_triangles)
    organ = made_once(tmp_path_factory, "stage", lambda: generate_colon(parameters, seed=0))
    albedo = np.random.default_rng(0).integers(90, 200, (64, 64, 3), dtype=np.uint8)
    look = Appearance(albedo, np.full((64, 64), 100, np.uint8), np.zeros((64, 64)))
    return make_stage(replace(organ, appearance=look), num_views=3)
