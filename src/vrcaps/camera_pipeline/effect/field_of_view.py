"""A narrower field of view."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.camera.derive import scaled_lens
from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.config.limits import Range

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class FieldOfView(CameraEffect):
    """Lens with a longer focal length on the same sensor.

    Attributes:
        magnification: Factor on the focal length; above 1 the field of view is narrower.
    """

    magnification: Annotated[float, Range(min=0.1, max=10.0)]

    name, short = "field_of_view", "fov"
    severities = (
        None,
        {"magnification": 1.2},
        {"magnification": 1.45},
        {"magnification": 1.75},
        {"magnification": 2.1},
    )

    def on(self, camera: Camera) -> Camera:
        """Return the camera with this lens."""
        lens, scale, circle = camera.lens, self.magnification, camera.image_circle_px
        return replace(
            camera,
            lens=scaled_lens(lens, scale, (lens.cx, lens.cy)),
            image_circle_px=None if circle is None else circle * scale,
        )
