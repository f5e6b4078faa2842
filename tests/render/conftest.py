import numpy as np
import pytest

from tests.support.textured_tube import tube

__all__ = ["tube"]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)
