"""Bloom."""

from __future__ import annotations

from dataclasses import dataclass

from vrcaps.camera.derive import focal_length_px
from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.errors import require


@dataclass(frozen=True)
class Bloom(ImageEffect):
    """Light scattered in the lens and its dome: a halo and a veil around what is bright.

    The point-spread function is ``(1 − s) δ + s (G(σ) + G(4σ)) / 2`` with Gaussians G.

    Attributes:
        fraction: s, the fraction of the light that is scattered.
        angle: σ, the halo's standard deviation [rad].
    """

    fraction: float
    angle: float = 0.05

    name = "bloom"
    severities = (
        None,
        {"fraction": 0.03},
        {"fraction": 0.08},
        {"fraction": 0.16},
        {"fraction": 0.3},
    )

    def __post_init__(self) -> None:
        fraction = self.fraction
        require(0.0 < fraction < 1.0, "Bloom's fraction", fraction, "above 0 to below 1")
        require(0.0 < self.angle < 1.0, "Bloom's angle", self.angle, "above 0 to 1 rad")

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Fraction and standard deviation [px]."""
        return self.fraction, self.angle * focal_length_px(setup.camera.lens)
