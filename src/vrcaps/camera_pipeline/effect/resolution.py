"""A lower resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.limits import Range

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class Resolution(CameraEffect):
    """A sensor of the same size with fewer and larger pixels.

    Attributes:
        scale: Pixels to a side, relative to the camera's own.
    """

    scale: Annotated[float, Range(above=0.0, most=4.0)]

    name = "resolution"
    severities = (None, {"scale": 0.75}, {"scale": 0.5}, {"scale": 0.375}, {"scale": 0.25})

    def on(self, camera: Camera) -> Camera:
        """The camera with such a sensor.

        Raises:
            InputError: If fewer than 8 pixels are left to a side.
        """
        return scaled_camera(camera, self.scale)
