"""A lower resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.errors import require

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class Resolution(CameraEffect):
    """A sensor of the same size with fewer and larger pixels.

    Attributes:
        scale: Pixels to a side, relative to the camera's own.
    """

    scale: float

    name = "resolution"
    severities = (None, {"scale": 0.75}, {"scale": 0.5}, {"scale": 0.375}, {"scale": 0.25})

    def __post_init__(self) -> None:
        require(0.0 < self.scale <= 4.0, "Resolution's scale", self.scale, "above 0 to 4")

    def on(self, camera: Camera) -> Camera:
        """The camera with such a sensor.

        Raises:
            InputError: If fewer than 8 pixels are left to a side.
        """
        return scaled_camera(camera, self.scale)
