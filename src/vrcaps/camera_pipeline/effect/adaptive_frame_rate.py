"""Adaptive frame rate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera_pipeline.effect.base import TimingEffect
from vrcaps.core.errors import InputError, require

if TYPE_CHECKING:
    from jaxtyping import Float

_SLACK = 1e-6
"""Rounding tolerance of a time, as a fraction of the frame interval."""


@dataclass(frozen=True)
class AdaptiveFrameRate(TimingEffect):
    """Frame rate that increases with image motion.

    The rate increases linearly from `min_fps` to `max_fps` as the image motion increases from
    `low_motion` to `high_motion`. A frame is captured once the interval of the rate has passed
    since the last captured frame. Frames are recorded at the recording's own rate, which should be
    `max_fps` or more; a column of the table marks the captured ones. PillCam SB 3 captures 2 to 6
    frames per second, PillCam COLON 2 captures 4 to 35 (manufacturers' data); their control laws
    are not published.

    Attributes:
        min_fps: Minimum frame rate [1/s].
        max_fps: Maximum frame rate [1/s].
        low_motion: Image speed up to which the rate is minimal [half sides of the image/s].
        high_motion: Image speed from which the rate is maximal [half sides/s].
    """

    min_fps: float
    max_fps: float
    low_motion: float = 0.05
    high_motion: float = 0.5

    name, short = "adaptive_frame_rate", "afr"

    def __post_init__(self) -> None:
        rates, speeds = (self.min_fps, self.max_fps), (self.low_motion, self.high_motion)
        is_valid = 0.0 < self.min_fps <= self.max_fps < math.inf
        require(is_valid, "AdaptiveFrameRate's min_fps, max_fps", rates, "above 0 and rising")
        is_valid = 0.0 <= self.low_motion < self.high_motion < math.inf
        allowed = "0 or more and rising"
        require(is_valid, "AdaptiveFrameRate's low_motion, high_motion", speeds, allowed)

    @classmethod
    def parse(cls, text: str) -> AdaptiveFrameRate:
        """Parse a range `MIN..MAX` in frames per second.

        Raises:
            InputError: If the text is not a range.
        """
        low, dots, high = text.partition("..")
        try:
            return cls(float(low), float(high if dots else low))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"Effect {cls.name} is {text!r}. Allowed: {cls.name}=MIN..MAX in frames a second, "
                "such as 2..6."
            ) from error

    def frame_rate(self, speed: float) -> float:
        """Frames per second at an image speed [half sides/s]."""
        weight = (speed - self.low_motion) / (self.high_motion - self.low_motion)
        return self.min_fps + (self.max_fps - self.min_fps) * min(max(weight, 0.0), 1.0)

    def is_due(self, speed: float, frames: int, fps: float) -> bool:
        """Check whether a frame is captured.

        Args:
            speed: Image speed [half sides/s].
            frames: Frames of the recording since the last captured one.
            fps: Frames per second of the recording.
        """
        return frames >= fps / self.frame_rate(speed) - _SLACK


def image_speed(
    motion: Float[np.ndarray, "h w 2"] | None, half_side_px: float, fps: float
) -> float:
    """Median image speed [half sides/s] from the motion per frame interval [px].

    Returns 0 if no motion is known.
    """
    if motion is None:
        return 0.0
    length = np.linalg.norm(motion, axis=-1)
    known = length[np.isfinite(length)]
    return float(np.median(known)) / half_side_px * fps if known.size else 0.0
