"""Effects of the image signal processor (ISP): white balance and JPEG compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.config.limits import Range
from vrcaps.core.errors import require

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class WhiteBalance(ImageEffect):
    """Gains that compensate the sensor's response to red and blue, with a residual color cast.

    Attributes:
        gains: Residual factor of each color after balancing; 1, 1, 1 is neutral.
        response: Response of red, green and blue sites to white; the lower, the more a color is
            amplified, with its noise.
    """

    gains: Triple = (1.0, 1.0, 1.0)
    response: Triple = (0.6, 1.0, 0.7)

    name, short = "white_balance", "wb"
    severities = (
        None,
        {"gains": (1.04, 1.0, 0.96)},
        {"gains": (1.08, 1.0, 0.9)},
        {"gains": (1.15, 1.0, 0.8)},
        {"gains": (1.25, 1.0, 0.65)},
    )

    def __post_init__(self) -> None:
        for name in ("gains", "response"):
            values = getattr(self, name)
            is_valid = all(0.0 < v < 100.0 for v in values)
            require(is_valid, f"WhiteBalance's {name}", values, "three numbers above 0 to 100")

    def params(self, setup: CameraSetup) -> tuple[Triple, Triple]:
        """Gains and response."""
        return self.gains, self.response


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
