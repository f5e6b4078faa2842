"""Stages of the sensor: from the linear image that reaches it to the 8-bit image it sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps import _core
from vrcaps.errors import require

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

Mosaic = Literal["none", "rggb", "bggr", "grbg", "gbrg"]
"""Colours of 2 by 2 sites, row by row; `none` is a sensor with all colours at each pixel."""

_FIXED = 1 << 62
"""First stream of the fixed pattern, beyond those of all frames."""


def mosaic_colors(mosaic: Mosaic) -> tuple[int, int, int, int] | None:
    """Plane of each of the 2 by 2 sites, row by row."""
    if mosaic == "none":
        return None
    a, b, c, d = ("rgb".index(letter) for letter in mosaic)
    return a, b, c, d


@dataclass(frozen=True)
class Noise:
    """From light to numbers, as in the photon-transfer model (Janesick 2007; EMVA 1288).

    The number of electrons of a site is a Poisson variable (below a mean of 12 drawn exactly, above
    it a normal variable with the Poisson skewness, rounded). Read noise, a normal variable, and the
    site's offset are added; where read noise hides that electrons are whole, from 3.5 of them on,
    both are drawn as one variable with the variance and skewness of their sum. Amplified and
    rounded it is a number from 0 to 2^bits − 1. White is the full well at gain 1. So a number's
    variance is `K · (mean − black) + K² read_noise²`, plus rounding, with K the number's step for
    an electron.

    Attributes:
        full_well: Electrons of white.
        read_noise: Standard deviation of reading a site [electrons].
        prnu: Standard deviation of the sites' responses, as a share.
        dsnu: Standard deviation of the sites' offsets [electrons].
        bits: Of the converter.
        black: Number for no light.
        sensor: Seed of the sites' responses and offsets.
    """

    full_well: float
    read_noise: float
    prnu: float = 0.0
    dsnu: float = 0.0
    bits: int = 10
    black: int = 64
    sensor: int = 0

    def __post_init__(self) -> None:
        require(
            1.0 <= self.full_well <= 1e6, "Noise's full_well", self.full_well, "1 to 1e6 electrons"
        )
        for name, unit in (("read_noise", " electrons"), ("prnu", ""), ("dsnu", " electrons")):
            value = getattr(self, name)
            require(0.0 <= value < 1e5, f"Noise's {name}", value, f"0{unit} or more")
        require(1 <= self.bits <= 16, "Noise's bits", self.bits, "1 to 16")
        highest = 2**self.bits - 2
        require(0 <= self.black <= highest, "Noise's black", self.black, f"0 to {highest}")
        require(self.sensor >= 0, "Noise's sensor", self.sensor, "0, 1, 2, …")

    def step(self, gain: float = 1.0) -> float:
        """K: what one electron adds to a number, at a gain."""
        return gain * (2**self.bits - 1 - self.black) / self.full_well

    def fixed_pattern(
        self, shape: tuple[int, int], camera: int
    ) -> tuple[Float[np.ndarray, "n w"], Float[np.ndarray, "n w"]]:
        """Response of each site relative to the mean, and its offset [electrons].

        Args:
            shape: Of the sites; three times the image's height without a mosaic.
            camera: Which of the capsule's cameras.
        """
        first, second = (
            _core.standard_normal(shape, self.sensor, _FIXED + 2 * camera + k) for k in (0, 1)
        )
        response = np.maximum(1.0 + self.prnu * first, 0.0)
        return response.astype(np.float32), (self.dsnu * second).astype(np.float32)

    def readout(
        self, gain: float, response: tuple[float, float, float], light: float = 1.0
    ) -> dict[str, object]:
        """What the core reads a sensor by, under so much of the image's light."""
        return {
            "light": light,
            "full_well": self.full_well,
            "read_noise": self.read_noise,
            "gain": gain,
            "white": float(2**self.bits - 1),
            "black": float(self.black),
            "response": response,
        }


@dataclass(frozen=True)
class WhiteBalance:
    """Red and blue sites respond less than green ones, and gains make up for it, or not quite.

    Attributes:
        gains: What is left of each colour after balancing; 1, 1, 1 is neutral.
        response: Of red, green and blue sites to white; the less, the more a colour is amplified,
            with its noise.
    """

    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    response: tuple[float, float, float] = (0.6, 1.0, 0.7)

    def __post_init__(self) -> None:
        for name in ("gains", "response"):
            values = getattr(self, name)
            is_valid = all(0.0 < v < 100.0 for v in values)
            require(is_valid, f"WhiteBalance's {name}", values, "three numbers above 0 to 100")


@dataclass(frozen=True)
class Jpeg:
    """What baseline JPEG with colours at half the resolution leaves of the image.

    The image stored is the one read back from the JPEG.

    Attributes:
        quality: 1 to 100, on the scale of the Independent JPEG Group's library.
        most_bytes: Limit of the radio for a frame: the quality goes down until the frame fits;
            None is no limit.
    """

    quality: int
    most_bytes: int | None = None

    def __post_init__(self) -> None:
        require(1 <= self.quality <= 100, "Jpeg's quality", self.quality, "1 to 100")
        most = self.most_bytes
        require(most is None or most > 0, "Jpeg's most_bytes", most, "above 0 bytes, or none")

    def apply(self, rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """The image as it arrives."""
        quality = self.quality
        if self.most_bytes is not None:
            quality = _core.jpeg_quality(rgb, quality, self.most_bytes)
        return _core.jpeg(rgb, quality)
