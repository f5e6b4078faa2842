"""Adaptive frame rate: a capsule that takes more frames while its image moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float

_SLACK = 1e-6
"""Rounding allowed in a time, as a share of a frame's."""


@dataclass(frozen=True)
class AdaptiveRate:
    """How many frames a second a capsule takes, by how fast its image moves.

    The rate goes from `slow` to `fast` in proportion as the speed goes from `still` to `quick`, and
    a frame is taken once the rate's interval has passed since the last one taken. Frames are
    recorded at the recording's own rate, which should be `fast` or more; the table says which were
    taken. PillCam SB 3 has 2 to 6 frames a second, PillCam COLON 2 has 4 to 35 (makers' figures);
    their laws are not published.

    Attributes:
        slow: Least frames a second [1/s].
        fast: Most frames a second [1/s].
        still: Speed of the image up to which the rate is least [half sides of the image/s].
        quick: Speed from which it is largest.
    """

    slow: float
    fast: float
    still: float = 0.05
    quick: float = 0.5

    def __post_init__(self) -> None:
        rates, speeds = (self.slow, self.fast), (self.still, self.quick)
        is_valid = 0.0 < self.slow <= self.fast < math.inf
        require(is_valid, "AdaptiveRate's slow, fast", rates, "above 0 and rising")
        is_valid = 0.0 <= self.still < self.quick < math.inf
        require(is_valid, "AdaptiveRate's still, quick", speeds, "0 or more and rising")

    def rate(self, speed: float) -> float:
        """Frames a second at a speed of the image [half sides/s]."""
        share = (speed - self.still) / (self.quick - self.still)
        return self.slow + (self.fast - self.slow) * min(max(share, 0.0), 1.0)

    def is_due(self, speed: float, frames: int, fps: float) -> bool:
        """Whether a frame is taken.

        Args:
            speed: Of the image [half sides/s].
            frames: Frames of the recording since the last that was taken.
            fps: The recording's frames a second.
        """
        return frames >= fps / self.rate(speed) - _SLACK


def image_speed(
    motion: Float[np.ndarray, "h w 2"] | None, half_side_px: float, fps: float
) -> float:
    """Median speed of an image [half sides/s] from its motion in a frame's time [px].

    0 where no motion is known.
    """
    if motion is None:
        return 0.0
    length = np.linalg.norm(motion, axis=-1)
    known = length[np.isfinite(length)]
    return float(np.median(known)) / half_side_px * fps if known.size else 0.0
