"""How images are computed."""

from __future__ import annotations

from dataclasses import dataclass

from vrcaps.errors import InputError


@dataclass(frozen=True)
class RenderSettings:
    """How images are computed.

    Attributes:
        supersampling: Colour of a pixel is the mean over this many by this many rays. All other
            channels hold the value at the pixel's centre.
        shadows: Whether folds cast shadows from each LED.
    """

    supersampling: int = 1
    shadows: bool = False

    def __post_init__(self) -> None:
        if self.supersampling < 1:
            raise InputError(f"Supersampling is {self.supersampling}. Allowed: 1, 2, 3, …")
