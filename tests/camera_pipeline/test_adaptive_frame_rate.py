import numpy as np
import pytest

from vrcaps.camera_pipeline.effect.exposure import AdaptiveFrameRate, image_speed
from vrcaps.core.errors import InputError


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
        ({"min_fps": 2.0, "max_fps": 6.0, "low_motion": 1.0}, "low_motion, high_motion is"),
    ],
)
def test_what_cannot_be(given: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        AdaptiveFrameRate(**given)
