"""JPEG compression."""

from __future__ import annotations

from dataclasses import dataclass

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.errors import require


@dataclass(frozen=True)
class Jpeg(ImageEffect):
    """Loss of baseline JPEG compression with chroma at half the resolution.

    The image stored is the one decoded from the JPEG.

    Attributes:
        quality: 1 to 100, on the scale of the Independent JPEG Group's library.
        max_bytes: Limit of the radio for a frame: the quality goes down until the frame fits;
            None is no limit.
    """

    quality: int
    max_bytes: int | None = None

    name = "jpeg"
    severities = (None, {"quality": 90}, {"quality": 75}, {"quality": 50}, {"quality": 25})

    def __post_init__(self) -> None:
        require(1 <= self.quality <= 100, "Jpeg's quality", self.quality, "1 to 100")
        limit = self.max_bytes
        require(limit is None or limit > 0, "Jpeg's max_bytes", limit, "above 0 bytes, or none")

    def params(self, setup: CameraSetup) -> tuple[int, int | None]:
        """Quality, and limit of the file [bytes]."""
        return self.quality, self.max_bytes
