"""Automatic exposure, and the frame rate that adapts to motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vrcaps.camera_pipeline.effect.exposure import AdaptiveFrameRate, AutoExposure, image_speed
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


def test_settled_exposure_leaves_an_error_by_position() -> None:
    """Its logarithm has the tolerance as deviation, and changes little within a millimeter."""
    automatic = AutoExposure(0.0, tolerance=0.3)
    errors = np.log([automatic.remainder(0.02 * k, 5) for k in range(2000)])
    assert errors.mean() == pytest.approx(0.0, abs=0.03)
    assert errors.std() == pytest.approx(0.3, rel=0.1)
    near = np.log([automatic.remainder(1e-3 * k, 5) for k in range(200)])
    assert np.abs(np.diff(near)).max() < 0.15
    dim = automatic.settle(lambda exposure: 0.1 * exposure, 0.5)
    assert dim == pytest.approx(0.5 * automatic.target / 0.1, rel=1e-3)
    assert AutoExposure(0.0).remainder(0.1, 5) == 1.0


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"time_constant": 1.0, "tolerance": 2.0}, "tolerance is 2.0"),
        ({"time_constant": -1.0}, "time_constant is -1.0"),
        ({"time_constant": 1.0, "target": 1.0}, "target is 1.0"),
        ({"time_constant": 1.0, "min_light": 3.0}, "min_light, max_light is"),
        ({"time_constant": 1.0, "max_gain": 0.5}, "max_gain is 0.5"),
    ],
)
def test_impossible_exposures(given: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        AutoExposure(**given)


def captured(rate: AdaptiveFrameRate, speed: float, fps: float, count: int) -> np.ndarray:
    """Numbers of the frames that are captured of an image at an even speed."""
    frames = [0]
    for k in range(1, count):
        if rate.is_due(speed, k - frames[-1], fps):
            frames.append(k)
    return np.array(frames)


@pytest.mark.parametrize(("speed", "expected"), [(0.0, 4.0), (0.275, 19.5), (3.0, 35.0)])
def test_rate_goes_with_the_speed_of_the_image(speed: float, expected: float) -> None:
    rate = AdaptiveFrameRate(4.0, 35.0)
    assert rate.frame_rate(speed) == pytest.approx(expected)
    frames = captured(rate, speed, 140.0, 1400)
    assert np.diff(frames).mean() == pytest.approx(np.ceil(140.0 / expected - 1e-6))


def test_no_frame_is_left_out_at_the_recordings_own_rate() -> None:
    assert len(captured(AdaptiveFrameRate(2.0, 6.0), 1.0, 6.0, 50)) == 50


def test_speed_is_the_median_motion() -> None:
    motion = np.zeros((4, 5, 2))
    motion[..., 0] = 3.0
    motion[0] = np.nan
    motion[1, 0] = 100.0
    assert image_speed(motion, 60.0, 4.0) == pytest.approx(0.2)
    assert image_speed(np.full((2, 2, 2), np.nan), 60.0, 4.0) == 0.0
    assert image_speed(None, 60.0, 4.0) == 0.0


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"min_fps": 0.0, "max_fps": 6.0}, "min_fps, max_fps is"),
        ({"min_fps": 6.0, "max_fps": 2.0}, "min_fps, max_fps is"),
        ({"min_fps": 2.0, "max_fps": 1e300}, "Allowed: above 0 to 10000, ascending"),
        ({"min_fps": 2.0, "max_fps": 6.0, "low_motion": 1.0}, "low_motion, high_motion is"),
    ],
)
def test_impossible_frame_rates(given: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        AdaptiveFrameRate(**given)
