"""Motion blur."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.config.limits import Range


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
            for always.
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
