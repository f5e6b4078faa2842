"""JPEG compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.config.limits import Range


@dataclass(frozen=True)
class Jpeg(ImageEffect):
    """Compression loss of baseline JPEG with chroma at half resolution.

    The stored image is the decoded JPEG.

    Attributes:
        quality: 1 to 100, on the scale of the Independent JPEG Group's library.
        max_bytes: Size limit of a frame, set by the radio: the quality decreases until the frame
            fits; None is no limit.
    """

    quality: Annotated[int, Range(min=1, max=100)]
    max_bytes: Annotated[int | None, Range(min=1, unit="bytes")] = None

    name = "jpeg"
    severities = (None, {"quality": 90}, {"quality": 75}, {"quality": 50}, {"quality": 25})

    def params(self, setup: CameraSetup) -> tuple[int, int | None]:
        """Quality, and size limit of the file [bytes]."""
        return self.quality, self.max_bytes
