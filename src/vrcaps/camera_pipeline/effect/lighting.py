"""Effects of the LEDs: unequal light of the LEDs of one capsule."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.config.limits import Range
from vrcaps.core.rng import stream

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class LedBalance(CameraEffect):
    """Unequal intensities and colors of a camera's LEDs, as they vary in production.

    The intensity of an LED is multiplied by ``exp(spread z)`` for all colors, and by
    ``exp(color_spread z)`` for red and blue, with standard normal z. The sum over the LEDs is kept
    for each color.

    Attributes:
        spread: Standard deviation of the natural logarithm of an LED's intensity.
        color_spread: Standard deviation of the logarithm of red and blue relative to green.
        seed: Seed of the LEDs.
    """

    spread: Annotated[float, Range(min=0.0, max=2.0)]
    color_spread: Annotated[float, Range(min=0.0, max=1.0)] = 0.0
    seed: Annotated[int, Range(min=0)] = 0

    name = "led_balance"
    severities = (
        None,
        {"spread": 0.05, "color_spread": 0.01},
        {"spread": 0.1, "color_spread": 0.02},
        {"spread": 0.2, "color_spread": 0.04},
        {"spread": 0.4, "color_spread": 0.08},
    )

    def on(self, camera: Camera) -> Camera:
        """Return the camera with these LEDs."""
        intensity = np.array([led.intensity for led in camera.leds], float)
        if not intensity.any():
            return camera
        rng = stream(self.seed, f"camera/leds/{camera.name}")
        spread = self.spread * rng.standard_normal((len(intensity), 1))
        colors = self.color_spread * rng.standard_normal((len(intensity), 3)) * (1.0, 0.0, 1.0)
        varied = intensity * np.exp(spread + colors)
        total = varied.sum(axis=0)
        varied *= np.divide(intensity.sum(axis=0), total, out=np.zeros(3), where=total > 0.0)
        leds = (
            replace(led, intensity=(red, green, blue))
            for led, (red, green, blue) in zip(camera.leds, varied.tolist(), strict=True)
        )
        return replace(camera, leds=tuple(leds))
