"""Effects of exposure and timing: motion blur, shutter, automatic exposure, adaptive frame rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np

from vrcaps.camera_pipeline.effect.base import (
    CameraSetup,
    FrameContext,
    ImageEffect,
    Severity,
    Stage,
    TimingEffect,
)
from vrcaps.capsule.device import MAX_FRAME_RATE
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range
from vrcaps.core.rng import normal_along
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class MotionBlur(ImageEffect):
    """Motion of the capsule and the wall while the shutter is open and the LEDs are lit.

    A row collects light while its shutter is open and the LEDs are lit. The fraction of light that
    it collects is the fraction of the pulse within its exposure; the LEDs emit the same total light
    for any pulse length. With a rolling shutter, a pulse during which all rows are open freezes the
    image as a global shutter does; a row that is not open during the pulse is black.

    Attributes:
        exposure_time: Time for which each row is open [s]; limited to the frame interval.
        led_pulse: Time for which the LEDs are lit, centered on the instant of the image [s]; None
            if they are always lit.
    """

    exposure_time: Annotated[float, Range(above=0.0, below=10.0, unit="s")]
    led_pulse: Annotated[float | None, Range(above=0.0, below=10.0, unit="s")] = None

    name, short = "motion_blur", "blur"
    needs = ("foreground_label", "foreground_depth")
    needs_motion = True
    severities = (
        None,
        {"exposure_time": 0.01},
        {"exposure_time": 0.025},
        {"exposure_time": 0.05},
        {"exposure_time": 0.1},
    )

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Exposure time and pulse [frames]."""
        interval = 1.0 / setup.fps
        pulse = np.inf if self.led_pulse is None else self.led_pulse / interval
        return min(self.exposure_time / interval, 1.0), pulse


@dataclass(frozen=True)
class RollingShutter(ImageEffect):
    """Rows exposed one after another, from top to bottom.

    Attributes:
        readout_time: Time from the exposure of the first row to that of the last [s]; limited to
            the frame interval.
    """

    readout_time: Annotated[float, Range(above=0.0, below=10.0, unit="s")]

    name = "rolling_shutter"
    needs = ("foreground_label", "foreground_depth")
    needs_motion = True
    severities = (
        None,
        {"readout_time": 0.03},
        {"readout_time": 0.08},
        {"readout_time": 0.16},
        {"readout_time": 0.3},
    )

    def params(self, setup: CameraSetup) -> float:
        """Readout time [frames]."""
        return min(self.readout_time / (1.0 / setup.fps), 1.0)


_TOLERANCE = 1e-4
_ITERATIONS = 40
"""Relative change of the exposure at which `AutoExposure.settle` ends, and its maximum
iterations."""
_REMAINDER_LENGTH = 20.0 * MM
"""Correlation length along the gut of the remaining error of a settled loop [m]."""


@dataclass(frozen=True)
class AutoExposure(ImageEffect):
    """Automatic exposure: LED light and then gain follow the brightness of the image.

    With a time constant it is a control loop over frames, an integrator in the logarithm of the
    exposure E. The camera meters the mean linear luminance m of a frame, each pixel clipped at
    white. The next exposure, Δt later, follows from ``ln E += (1 − exp(−Δt/τ)) ln(target / m)``
    within the limits: in a static scene, and far from white, the error ``ln(target / m)`` decreases
    by exp(−Δt/τ) per frame. The loop has settled in the first frame.

    With a time constant of 0 the loop has settled in every frame: m is the target, within the
    limits, and frames are independent of each other. This is the default of a capsule (an
    assumption: no manufacturer publishes the time constant of its light control). A loop leaves the
    exposure as it is while the error is small; that remainder is a log-normal factor on the target,
    which changes over 20 mm of the gut.

    The LEDs deliver E up to their maximum light; the rest is gain, which adds noise because it adds
    no photons.

    Attributes:
        time_constant: τ [s]; 0 for a loop that has settled in every frame.
        target: Target mean linear luminance, 1 = white. The default is chosen by comparison with
            real capsule frames.
        min_light: Minimum light, relative to the camera's own fixed exposure.
        max_light: Maximum light, relative to the same.
        max_gain: Maximum gain.
        tolerance: Standard deviation of the remaining error ``ln(target / m)`` of a settled loop.
    """

    time_constant: float
    target: float = 0.12
    min_light: float = 0.02
    max_light: float = 2.0
    max_gain: float = 8.0
    tolerance: float = 0.0

    name, short = "auto_exposure", "ae"
    severities = (
        None,
        {"time_constant": 0.3},
        {"time_constant": 1.0},
        {"time_constant": 2.0},
        {"time_constant": 5.0},
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        time, gain = self.time_constant, self.max_gain
        require(0.0 <= time < math.inf, "AutoExposure's time_constant", time, "0 s or more")
        require(0.0 < self.target < 1.0, "AutoExposure's target", self.target, "above 0 to below 1")
        limits = (self.min_light, self.max_light)
        is_valid = 0.0 < self.min_light <= self.max_light < math.inf
        require(is_valid, "AutoExposure's min_light, max_light", limits, "above 0 and ascending")
        require(1.0 <= gain < math.inf, "AutoExposure's max_gain", gain, "1 or more")
        error = self.tolerance
        require(0.0 <= error <= 1.0, "AutoExposure's tolerance", error, "0 to 1")

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

    def remainder(self, arc_length: float, seed: int) -> float:
        """Factor on the target that a settled loop leaves at a position along the gut.

        Args:
            arc_length: Position along the centerline [m].
            seed: Seed of the recording.
        """
        place = arc_length / _REMAINDER_LENGTH
        return math.exp(self.tolerance * normal_along(place, seed, "camera/exposure/remainder"))

    def settle(self, meter: Callable[[float], float], remainder: float = 1.0) -> float:
        """Exposure at which a frame has the target luminance, within the limits.

        Fixed-point iteration ``E ← E target / m(E)``: m increases no faster than E, because pixels
        are clipped at white, so each step approaches the solution.

        Args:
            meter: Mean luminance of the frame as a function of exposure; must not decrease.
            remainder: Factor on the target.
        """
        highest = self.max_light * self.max_gain
        exposure = min(max(1.0, self.min_light), highest)
        for _ in range(_ITERATIONS):
            ratio = self.target * remainder / max(meter(exposure), 1e-9)
            before, exposure = exposure, min(max(exposure * ratio, self.min_light), highest)
            if abs(exposure - before) <= _TOLERANCE * before:
                break
        return exposure

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
        super().__post_init__()
        rates, speeds = (self.min_fps, self.max_fps), (self.low_motion, self.high_motion)
        is_valid = 0.0 < self.min_fps <= self.max_fps <= MAX_FRAME_RATE
        allowed = f"above 0 to {MAX_FRAME_RATE:g}, ascending"
        require(is_valid, "AdaptiveFrameRate's min_fps, max_fps", rates, allowed)
        is_valid = 0.0 <= self.low_motion < self.high_motion < math.inf
        allowed = "0 or more and ascending"
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
                f"Effect {cls.name} is {text!r}. Allowed: {cls.name}=MIN..MAX in frames per "
                "second, such as 2..6."
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
