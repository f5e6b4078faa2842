import math

import numpy as np
import pytest

from vrcaps.camera_pipeline.effect.exposure import AutoExposure
from vrcaps.core.errors import InputError


def settle(automatic: AutoExposure, brightness: float, count: int, start: float = 1.0):
    """Exposures of frames of a scene whose luminance at exposure 1 is given, far from white."""
    exposures = [start]
    for _ in range(count):
        metered = brightness * exposures[-1]
        exposures.append(automatic.next_exposure(exposures[-1], metered, 0.25))
    return np.array(exposures)


@pytest.mark.parametrize("brightness", [0.03, 0.15, 1.0])
def test_error_shrinks_by_its_time_constant(brightness: float) -> None:
    """ln(E / E∞) falls as exp(−t/τ): after 5 τ less than 1 % of it is left."""
    automatic = AutoExposure(1.0, min_light=1e-6)
    exposures = settle(automatic, brightness, 20)
    goal = automatic.target / brightness
    expected = math.log(1.0 / goal) * np.exp(-0.25 * np.arange(21))
    assert np.log(exposures / goal) == pytest.approx(expected, abs=1e-9)


def test_exposure_keeps_to_its_limits() -> None:
    automatic = AutoExposure(0.1, min_light=0.1, max_light=2.0, max_gain=4.0)
    assert settle(automatic, 0.0, 50)[-1] == 8.0
    assert settle(automatic, 100.0, 50)[-1] == 0.1


def test_light_comes_before_gain() -> None:
    automatic = AutoExposure(1.0, max_light=2.0, max_gain=8.0)
    assert automatic.light_and_gain(0.5) == (0.5, 1.0)
    assert automatic.light_and_gain(2.0) == (2.0, 1.0)
    assert automatic.light_and_gain(10.0) == (2.0, 5.0)


@pytest.mark.parametrize("brightness", [0.01, 0.15, 1.0, 7.0])
def test_settled_exposure_meets_the_target(brightness: float) -> None:
    """A scene of luminance m at exposure 1 needs target / m; one brighter or darker, a limit."""
    automatic = AutoExposure(0.0, target=0.15)
    assert automatic.is_settled
    found = automatic.settle(lambda exposure: min(brightness * exposure, 1.0))
    assert found == pytest.approx(min(max(0.15 / brightness, 0.02), 16.0), rel=1e-3)
    assert automatic.settle(lambda _: 1.0) == pytest.approx(0.02, rel=1e-3)
    assert automatic.settle(lambda _: 0.0) == pytest.approx(16.0, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"time_constant": -1.0}, "time_constant is -1.0"),
        ({"time_constant": 1.0, "target": 1.0}, "target is 1.0"),
        ({"time_constant": 1.0, "min_light": 3.0}, "min_light, max_light is"),
        ({"time_constant": 1.0, "max_gain": 0.5}, "max_gain is 0.5"),
    ],
)
def test_what_cannot_be(given: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        AutoExposure(**given)
