"""A lower resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.config.limits import Range

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class Resolution(CameraEffect):
    """Sensor of the same size with fewer and larger pixels.

    Attributes:
        scale: Pixels per side, relative to the camera's own.
    """

    scale: Annotated[float, Range(above=0.0, max=4.0)]

    name = "resolution"
    severities = (None, {"scale": 0.75}, {"scale": 0.5}, {"scale": 0.375}, {"scale": 0.25})

    def on(self, camera: Camera) -> Camera:
        """Return the camera with this sensor.

        Raises:
            InputError: If fewer than 8 pixels per side remain.
        """
        return scaled_camera(camera, self.scale)
