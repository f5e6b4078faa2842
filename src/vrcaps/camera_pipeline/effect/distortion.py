"""Barrel distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.derive import barrel_lens, barrel_radius, half_side_px
from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.config.limits import Range

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class Distortion(CameraEffect):
    """Barrel distortion in addition to that of the camera's own lens.

    The center of the image is magnified; its nearest edge is preserved.

    Attributes:
        strength: Fraction by which the image radius at the nearest edge is smaller than the scale
            at the center implies.
    """

    strength: Annotated[float, Range(min=0.0, below=0.5)]

    name = "distortion"
    severities = (
        None,
        {"strength": 0.1},
        {"strength": 0.2},
        {"strength": 0.3},
        {"strength": 0.4},
    )

    def on(self, camera: Camera) -> Camera:
        """Return the camera with this distortion."""
        edge = half_side_px(camera)
        lens = barrel_lens(camera.lens, self.strength, edge)
        circle = camera.image_circle_px
        if circle is not None:
            circle = float(barrel_radius(np.array(circle), self.strength, edge))
        return replace(camera, lens=lens, image_circle_px=circle)
