"""Bloom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from vrcaps.camera.derive import focal_length_px
from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.config.limits import Range


@dataclass(frozen=True)
class Bloom(ImageEffect):
    """Light scattered in the lens and its dome: a halo and a veil around bright areas.

    The point-spread function is ``(1 − s) δ + s (G(σ) + G(4σ)) / 2`` with Gaussians G.

    Attributes:
        fraction: s, the fraction of the light that is scattered.
        angle: σ, the halo's standard deviation [rad].
    """

    fraction: Annotated[float, Range(above=0.0, below=1.0)]
    angle: Annotated[float, Range(above=0.0, below=1.0, unit="rad")] = 0.05

    name = "bloom"
    severities = (
        None,
        {"fraction": 0.03},
        {"fraction": 0.08},
        {"fraction": 0.16},
        {"fraction": 0.3},
    )

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Fraction and standard deviation [px]."""
        return self.fraction, self.angle * focal_length_px(setup.camera.lens)
