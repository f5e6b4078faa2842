"""Lateral chromatic aberration."""

from __future__ import annotations

from dataclasses import dataclass

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.errors import require


@dataclass(frozen=True)
class LateralChromaticAberration(ImageEffect):
    """Red and blue images that are larger or smaller than the green one, where the labels are.

    Attributes:
        red: Magnification of red less 1; a point at radius r is seen `red · r` further out.
        blue: Magnification of blue less 1.
    """

    red: float
    blue: float

    name, short = "chromatic_aberration", "ca"
    severities = (
        None,
        {"red": 0.002, "blue": -0.002},
        {"red": 0.005, "blue": -0.005},
        {"red": 0.01, "blue": -0.01},
        {"red": 0.02, "blue": -0.02},
    )

    def __post_init__(self) -> None:
        for name in ("red", "blue"):
            value = getattr(self, name)
            is_valid = -0.5 < value < 0.5
            require(is_valid, f"LateralChromaticAberration's {name}", value, "-0.5 to 0.5")

    def params(self, setup: CameraSetup) -> tuple[tuple[float, float], tuple[float, float, float]]:
        """Center [px] and scale of each color."""
        lens = setup.camera.lens
        return (lens.cx, lens.cy), (1.0 + self.red, 1.0, 1.0 + self.blue)
