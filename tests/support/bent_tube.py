"""A bent tube whose centerline and radius are known in closed form."""

import numpy as np
import pytest

from tests.support.tubes import bent_tube
from vrcaps.capsule.device_file import read_device
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model


@pytest.fixture(scope="session")
def tube() -> OrganSurface:
    return bent_tube()


@pytest.fixture(scope="session")
def model(tube: OrganSurface) -> Model:
    return Model(tube, read_device("mirocam"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
