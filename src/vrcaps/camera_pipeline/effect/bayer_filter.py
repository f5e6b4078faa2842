"""Bayer color filter array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.core.errors import InputError

BayerPattern = Literal["rggb", "bggr", "grbg", "gbrg"]
"""Colors of 2 by 2 sites, in row-major order."""


@dataclass(frozen=True)
class BayerFilter(ImageEffect):
    """Color filter array of the sensor, demosaiced; without it every pixel has all three colors.

    Attributes:
        pattern: Colors of 2 by 2 sites, in row-major order.
    """

    pattern: BayerPattern = "rggb"

    name, short = "bayer_filter", "bayer"

    def __post_init__(self) -> None:
        if self.pattern not in get_args(BayerPattern):
            allowed = ", ".join(get_args(BayerPattern))
            raise InputError(f"BayerFilter's pattern is {self.pattern!r}. Allowed: {allowed}.")

    @classmethod
    def parse(cls, text: str) -> BayerFilter:
        """Parse a pattern such as `rggb`."""
        return cls(text)  # type: ignore[arg-type]

    def params(self, setup: CameraSetup) -> tuple[int, int, int, int]:
        """Color plane of each of the 2 by 2 sites, in row-major order."""
        a, b, c, d = ("rgb".index(letter) for letter in self.pattern)
        return a, b, c, d
