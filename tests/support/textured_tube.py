"""A straight tube with a mucosa, on which geodesics, masks and streams have closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_tube
from vrcaps.core.units import MM
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.organ.surface import OrganSurface

RADIUS, LENGTH, COLUMNS, ROWS = 18.0 * MM, 160.0 * MM, 72, 104


def make_tube() -> OrganSurface:
    """Open at both ends, seen from inside; its texture wraps around it."""
    plain = straight_tube(LENGTH, RADIUS, COLUMNS, ROWS + 1)
    label = np.where(plain.arc_length < 0.5 * LENGTH, 1, 2).astype(np.uint8)
    return replace(plain, label=label, label_names=("background", "upper", "lower"))


@pytest.fixture(scope="session")
def tube() -> OrganSurface:
    plain = make_tube()
    assert (plain.normals[:, :2] * plain.vertices[:, :2]).sum(axis=1).max() < 0.0
    return replace(plain, appearance=bake_appearance(plain, seed=1, texels_per_mm=3.0))
