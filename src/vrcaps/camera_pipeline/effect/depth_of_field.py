"""Depth of field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.derive import focal_length_px
from vrcaps.camera_pipeline.effect.base import CameraSetup, FrameContext, ImageEffect, Stage
from vrcaps.config.limits import Range

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class DepthOfField(ImageEffect):
    """Defocus blur of a thin lens focused at one distance.

    A point at distance d spreads over a disk, the circle of confusion, whose diameter is
    ``c = A v |1/s − 1/d|`` with the aperture diameter A, the focus distance s and the distance v of
    the sensor behind the lens (from 1/f = 1/s + 1/v; Potmesil and Chakravarty, SIGGRAPH 1981). In
    pixels, v is the focal length of the lens on the axis. Distances are along the ray: the surface
    in focus is a sphere, as appropriate for a fisheye lens.

    Attributes:
        aperture: Diameter of the entrance pupil, focal length over f-number [m].
        focus_distance: Distance in focus [m].
    """

    aperture: Annotated[float, Range(above=0.0, below=1.0, unit="m")]
    focus_distance: Annotated[float, Range(above=0.0, unit="m")] = 0.012

    name, short = "depth_of_field", "dof"
    needs = ("ray_distance", "foreground_label", "foreground_depth")
    severities = (
        None,
        {"aperture": 0.0002},
        {"aperture": 0.0005},
        {"aperture": 0.001},
        {"aperture": 0.002},
    )

    def radius_px(
        self, camera: Camera, distance: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Radius of the circle of confusion of points at distances [m] from a camera [px]."""
        return self._scale(camera) * np.abs(1.0 / self.focus_distance - 1.0 / np.asarray(distance))

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Radius per change of 1/d [px·m] and focus distance [m]."""
        return self._scale(setup.camera), self.focus_distance

    def stage(self, setup: CameraSetup) -> Stage:
        """Stage that takes the distance of the surface in each pixel."""
        return _DepthOfFieldStage(self.params(setup))

    def _scale(self, camera: Camera) -> float:
        return 0.5 * self.aperture * focal_length_px(camera.lens)


class _DepthOfFieldStage(Stage):
    def frame_params(self, frame: FrameContext) -> tuple[np.ndarray, ...]:
        """Distance of the wall, label and depth of the foreground."""
        return tuple(frame.channels[name] for name in DepthOfField.needs)
