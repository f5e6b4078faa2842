"""Vignetting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import camera_rays, pixel_grid
from vrcaps.camera.derive import half_side_px
from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.core.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Vignetting(ImageEffect):
    """Darkening towards the edge of the image.

    A pixel at distance ρ from the lens center, in halves of the image's shorter side, and at angle
    θ to the axis receives ``(1 + Σ kᵢ ρ²ⁱ) cosⁿ θ`` of the light, but not less than 0.

    Attributes:
        coefficients: k₁, k₂, k₃.
        cosine_power: n; 4 is the natural vignetting of a thin lens.
    """

    coefficients: tuple[float, float, float]
    cosine_power: float = 0.0

    name = "vignetting"
    severities = (
        None,
        {"coefficients": (-0.2, 0.02, 0.0)},
        {"coefficients": (-0.4, 0.05, 0.0)},
        {"coefficients": (-0.6, 0.1, 0.0)},
        {"coefficients": (-0.8, 0.16, 0.0)},
    )

    def __post_init__(self) -> None:
        power = self.cosine_power
        is_finite = bool(np.isfinite(self.coefficients).all())
        require(is_finite, "Vignetting's coefficients", self.coefficients, "three finite numbers")
        require(0.0 <= power <= 16.0, "Vignetting's cosine_power", power, "0 to 16")

    def params(self, setup: CameraSetup) -> Float[np.ndarray, "h w"]:
        """Fraction of the light that each pixel receives, as float32."""
        camera = setup.camera
        offset = pixel_grid(camera.width, camera.height) - (camera.lens.cx, camera.lens.cy)
        square = (offset**2).sum(axis=-1) / half_side_px(camera) ** 2
        polynomial = np.polynomial.polynomial.polyval(square, (1.0, *self.coefficients))
        cosine = np.nan_to_num(camera_rays(camera)[..., 2].astype(float))
        natural = np.maximum(cosine, 0.0) ** self.cosine_power
        return (np.maximum(polynomial, 0.0) * natural).astype(np.float32)
