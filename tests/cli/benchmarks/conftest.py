from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.anatomy.colon import ColonParameters, generate_colon
from vrcaps.cli.benchmarks.stage import QUICK, Stage, make_stage
from vrcaps.organ.surface import Appearance


@pytest.fixture(scope="session")
def stage() -> Stage:
    """A coarse colon with a small texture: baking the full one takes longer than all tests."""
    organ = generate_colon(ColonParameters(triangles=QUICK.num_triangles), seed=0)
    albedo = np.random.default_rng(0).integers(90, 200, (64, 64, 3), dtype=np.uint8)
    look = Appearance(albedo, np.full((64, 64), 100, np.uint8), np.zeros((64, 64)))
    return make_stage(replace(organ, appearance=look), num_views=3)
