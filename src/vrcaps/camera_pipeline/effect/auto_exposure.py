"""Automatic exposure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from vrcaps.camera_pipeline.effect.base import (
    CameraSetup,
    FrameContext,
    ImageEffect,
    Severity,
    Stage,
)
from vrcaps.core.errors import require

_HALVINGS = 16
"""Bisection steps of `AutoExposure.settle`: 1e-4 of the exposure over three decades."""


@dataclass(frozen=True)
class AutoExposure(ImageEffect):
    """Automatic exposure: LED light and then gain follow the brightness of the image.

    With a time constant it is a control loop over frames, an integrator in the logarithm of the
    exposure E. The camera meters the mean linear luminance m of a frame, each pixel clipped at
    white. The next exposure, Δt later, follows from ``ln E += (1 − exp(−Δt/τ)) ln(target / m)``
    within the limits: in a static scene, and far from white, the error ``ln(target / m)`` decreases
    by exp(−Δt/τ) per frame. The loop starts at the camera's own exposure.

    With a time constant of 0 the loop has settled in every frame: m is the target, within the
    limits, and frames are independent of each other. This is the default of a capsule.

    The LEDs deliver E up to their maximum light; the rest is gain, which adds noise because it adds
    no photons.

    Attributes:
        time_constant: τ [s]; 0 for a loop that has settled in every frame.
        target: Target mean linear luminance, 1 = white. Real capsule frames have about 0.15.
        min_light: Minimum light, relative to the camera's own fixed exposure.
        max_light: Maximum light, relative to the same.
        max_gain: Maximum gain.
    """

    time_constant: float
    target: float = 0.15
    min_light: float = 0.02
    max_light: float = 2.0
    max_gain: float = 8.0

    name, short = "auto_exposure", "ae"
    severities = (
        None,
        {"time_constant": 0.3},
        {"time_constant": 1.0},
        {"time_constant": 2.0},
        {"time_constant": 5.0},
    )

    def __post_init__(self) -> None:
        time, target, gain = self.time_constant, self.target, self.max_gain
        require(0.0 <= time < math.inf, "AutoExposure's time_constant", time, "0 s or more")
        require(0.0 < target < 1.0, "AutoExposure's target", target, "above 0 to below 1")
        limits = (self.min_light, self.max_light)
        is_valid = 0.0 < self.min_light <= self.max_light < math.inf
        require(is_valid, "AutoExposure's min_light, max_light", limits, "above 0 and rising")
        require(1.0 <= gain < math.inf, "AutoExposure's max_gain", gain, "1 or more")

    @classmethod
    def parse(cls, text: str) -> Severity | Self:
        """Parse a severity, a range of severities, or `settled`.

        Raises:
            InputError: If the text is none of these.
        """
        return cls(time_constant=0.0) if text == "settled" else super().parse(text)

    @property
    def is_settled(self) -> bool:
        """True if each frame is exposed independently of the others."""
        return self.time_constant == 0.0

    def settle(self, meter: Callable[[float], float]) -> float:
        """Exposure at which a frame has the target luminance, within the limits.

        Args:
            meter: Mean luminance of the frame as a function of exposure; must not decrease.
        """
        low, high = math.log(self.min_light), math.log(self.max_light * self.max_gain)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if meter(math.exp(middle)) < self.target:
                low = middle
            else:
                high = middle
        return math.exp(0.5 * (low + high))

    def next_exposure(self, exposure: float, metered: float, interval: float) -> float:
        """Exposure of the next frame.

        Args:
            exposure: Exposure of this frame, relative to the camera's own.
            metered: Mean luminance of this frame.
            interval: Time to the next frame [s].
        """
        rate = -math.expm1(-interval / self.time_constant)
        error = math.log(self.target / max(metered, 1e-6))
        highest = self.max_light * self.max_gain
        return min(max(exposure * math.exp(rate * error), self.min_light), highest)

    def light_and_gain(self, exposure: float) -> tuple[float, float]:
        """Split an exposure into light and gain; their product is the exposure."""
        light = min(exposure, self.max_light)
        return light, exposure / light

    def stage(self, setup: CameraSetup) -> Stage:
        """Stage that takes light and gain of each frame."""
        return _AutoExposureStage(self)


class _AutoExposureStage(Stage):
    def __init__(self, effect: AutoExposure) -> None:
        super().__init__()
        self._effect = effect

    def frame_params(self, frame: FrameContext) -> tuple[float, float]:
        """Light and gain."""
        return self._effect.light_and_gain(frame.exposure)
