"""Lateral chromatic aberration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.config.limits import Range


@dataclass(frozen=True)
class LateralChromaticAberration(ImageEffect):
    """Red and blue images scaled relative to the green one, which matches the labels.

    Attributes:
        red: Magnification of red minus 1; a point at radius r appears `red · r` further out.
        blue: Magnification of blue minus 1.
    """

    red: Annotated[float, Range(above=-0.5, below=0.5)]
    blue: Annotated[float, Range(above=-0.5, below=0.5)]

    name, short = "chromatic_aberration", "ca"
    severities = (
        None,
        {"red": 0.002, "blue": -0.002},
        {"red": 0.005, "blue": -0.005},
        {"red": 0.01, "blue": -0.01},
        {"red": 0.02, "blue": -0.02},
    )

    def params(self, setup: CameraSetup) -> tuple[tuple[float, float], tuple[float, float, float]]:
        """Center [px] and scale of each color."""
        lens = setup.camera.lens
        return (lens.cx, lens.cy), (1.0 + self.red, 1.0, 1.0 + self.blue)
