"""A tube that is open at both ends."""

import pytest

from tests.support.fem_shapes import straight_tube
from vrcaps.organ.surface import OrganSurface


@pytest.fixture(scope="session")
def tube() -> OrganSurface:
    return straight_tube(radius=0.02, length=0.12, edge=0.0025)
