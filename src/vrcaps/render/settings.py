"""How images are computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vrcaps.errors import InputError


@dataclass(frozen=True)
class RenderSettings:
    """How images are computed.

    Attributes:
        supersampling: Colour of a pixel is the mean over this many by this many rays. All other
            channels hold the value at the pixel's centre.
        shadows: Whether folds cast shadows from each LED.
        imaging: White light, or narrow bands about 415 and 540 nm, in which vessels stand out.
    """

    supersampling: int = 1
    shadows: bool = False
    imaging: Literal["white-light", "narrow-band"] = "white-light"

    def __post_init__(self) -> None:
        if self.supersampling < 1:
            raise InputError(f"Supersampling is {self.supersampling}. Allowed: 1, 2, 3, …")
