import numpy as np
import pytest

from vrcaps.camera_pipeline.frame_rate import AdaptiveRate, image_speed
from vrcaps.errors import InputError


def taken(rate: AdaptiveRate, speed: float, fps: float, count: int) -> np.ndarray:
    """Numbers of the frames that are taken of an image at an even speed."""
    frames = [0]
    for k in range(1, count):
        if rate.is_due(speed, k - frames[-1], fps):
            frames.append(k)
    return np.array(frames)


@pytest.mark.parametrize(("speed", "expected"), [(0.0, 4.0), (0.275, 19.5), (3.0, 35.0)])
def test_rate_goes_with_the_speed_of_the_image(speed: float, expected: float) -> None:
    rate = AdaptiveRate(4.0, 35.0)
    assert rate.rate(speed) == pytest.approx(expected)
    frames = taken(rate, speed, 140.0, 1400)
    assert np.diff(frames).mean() == pytest.approx(np.ceil(140.0 / expected - 1e-6))


def test_no_frame_is_left_out_at_the_recordings_own_rate() -> None:
    assert len(taken(AdaptiveRate(2.0, 6.0), 1.0, 6.0, 50)) == 50


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
        ({"slow": 0.0, "fast": 6.0}, "slow, fast is"),
        ({"slow": 6.0, "fast": 2.0}, "slow, fast is"),
        ({"slow": 2.0, "fast": 6.0, "still": 1.0}, "still, quick is"),
    ],
)
def test_what_cannot_be(given: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        AdaptiveRate(**given)
