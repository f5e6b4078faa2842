"""Automatic exposure: LED light and gain follow the brightness of the frames before."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vrcaps.errors import require


@dataclass(frozen=True)
class AutoExposure:
    """A control loop over frames, an integrator in the logarithm of the exposure E.

    The camera meters the mean linear luminance m of a frame, each pixel cut at white, and takes for
    the next, Δt later, ``ln E += (1 − exp(−Δt/τ)) ln(target / m)`` within the limits: in a scene
    that stays, and far from white, the error ``ln(target / m)`` shrinks by exp(−Δt/τ) a frame. The
    LEDs deliver E until they are at their brightest; what is missing is gain, which makes no
    photons and so adds noise.

    Attributes:
        time_constant: τ [s].
        target: Mean linear luminance to reach, 1 = white. Real capsule frames have some 0.15.
        light_min: Least light, relative to the camera's own fixed exposure.
        light_max: Most light, relative to the same.
        gain_max: Largest gain.
    """

    time_constant: float
    target: float = 0.15
    light_min: float = 0.02
    light_max: float = 2.0
    gain_max: float = 8.0

    def __post_init__(self) -> None:
        time, target, gain = self.time_constant, self.target, self.gain_max
        require(0.0 < time < math.inf, "AutoExposure's time_constant", time, "above 0 s")
        require(0.0 < target < 1.0, "AutoExposure's target", target, "above 0 to below 1")
        limits = (self.light_min, self.light_max)
        is_valid = 0.0 < self.light_min <= self.light_max < math.inf
        require(is_valid, "AutoExposure's light_min, light_max", limits, "above 0 and rising")
        require(1.0 <= gain < math.inf, "AutoExposure's gain_max", gain, "1 or more")

    def following(self, exposure: float, metered: float, interval: float) -> float:
        """Exposure of the next frame.

        Args:
            exposure: Of this frame, relative to the camera's own.
            metered: Mean luminance of this frame.
            interval: Until the next frame [s].
        """
        rate = -math.expm1(-interval / self.time_constant)
        error = math.log(self.target / max(metered, 1e-6))
        highest = self.light_max * self.gain_max
        return min(max(exposure * math.exp(rate * error), self.light_min), highest)

    def split(self, exposure: float) -> tuple[float, float]:
        """Light and gain whose product is an exposure."""
        light = min(exposure, self.light_max)
        return light, exposure / light
