"""Rolling shutter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.config.limits import Range


@dataclass(frozen=True)
class RollingShutter(ImageEffect):
    """Rows exposed one after another, from top to bottom.

    Attributes:
        readout_time: Time from the exposure of the first row to that of the last [s]; limited to
            the frame interval.
    """

    readout_time: Annotated[float, Range(above=0.0, below=10.0, unit="s")]

    name = "rolling_shutter"
    needs = ("foreground_label", "foreground_depth")
    needs_motion = True
    severities = (
        None,
        {"readout_time": 0.03},
        {"readout_time": 0.08},
        {"readout_time": 0.16},
        {"readout_time": 0.3},
    )

    def params(self, setup: CameraSetup) -> float:
        """Readout time [frames]."""
        return min(self.readout_time / (1.0 / setup.fps), 1.0)
