"""Effects of the sensor: resolution, Bayer color filter array, noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from vrcaps import _core
from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effect.base import CameraEffect, CameraSetup, ImageEffect
from vrcaps.core.errors import require
from vrcaps.core.fields import Range
from vrcaps.core.rng import MAX_SEED

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.camera import Camera


@dataclass(frozen=True)
class Resolution(CameraEffect):
    """Sensor of the same size with fewer and larger pixels.

    Attributes:
        scale: Pixels per side, relative to the camera's own.
    """

    scale: Annotated[float, Range(above=0.0, max=4.0)]

    name = "resolution"
    severities = (None, {"scale": 0.75}, {"scale": 0.5}, {"scale": 0.375}, {"scale": 0.25})

    def on(self, camera: Camera) -> Camera:
        """Return the camera with this sensor.

        Raises:
            InputError: If fewer than 8 pixels per side remain.
        """
        return scaled_camera(camera, self.scale)


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

    @classmethod
    def parse(cls, text: str) -> BayerFilter:
        """Parse a pattern such as `rggb`."""
        return cls(text)  # type: ignore[arg-type]

    def params(self, setup: CameraSetup) -> tuple[int, int, int, int]:
        """Color plane of each of the 2 by 2 sites, in row-major order."""
        a, b, c, d = ("rgb".index(letter) for letter in self.pattern)
        return a, b, c, d


_FIXED = 1 << 62
"""First stream of the fixed pattern, beyond the streams of all frames."""


@dataclass(frozen=True)
class SensorNoise(ImageEffect):
    """Noise from photons to digital values: shot, fixed-pattern, read and quantization noise.

    This is the photon-transfer model (Janesick 2007; EMVA 1288). The number of electrons of a site
    is a Poisson variable (below a mean of 12 drawn exactly, above it a normal variable with the
    Poisson skewness, rounded). Read noise, a normal variable, and the site's offset are added. From
    a read noise of 3.5 electrons, which hides that electrons are discrete, both are drawn as one
    variable with the variance and skewness of their sum. Amplification and rounding give a digital
    value from 0 to 2^bits − 1. White is the full well at gain 1. The variance of a value is then
    `K · (mean − black) + K² read_noise²`, plus quantization, with K the overall system gain.

    Attributes:
        full_well: Electrons of white.
        read_noise: Standard deviation of reading a site [electrons].
        prnu: Photo response non-uniformity: standard deviation of the sites' responses, relative.
        dsnu: Dark signal non-uniformity: standard deviation of the sites' offsets [electrons].
        bits: Bits of the converter.
        black_level: Digital value without light.
        sensor_seed: Seed of the sites' responses and offsets.
    """

    full_well: float
    read_noise: float
    prnu: float = 0.0
    dsnu: float = 0.0
    bits: int = 10
    black_level: int = 64
    sensor_seed: int = 0

    name, short = "sensor_noise", "noise"
    severities = (
        None,
        {"full_well": 12000.0, "read_noise": 4.0, "prnu": 0.005, "dsnu": 1.0},
        {"full_well": 5000.0, "read_noise": 8.0, "prnu": 0.01, "dsnu": 3.0},
        {"full_well": 2000.0, "read_noise": 12.0, "prnu": 0.02, "dsnu": 6.0},
        {"full_well": 700.0, "read_noise": 16.0, "prnu": 0.03, "dsnu": 10.0},
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        well, black = self.full_well, self.black_level
        require(1.0 <= well <= 1e6, "SensorNoise's full_well", well, "1 to 1e6 electrons")
        for name, unit in (("read_noise", " electrons"), ("prnu", ""), ("dsnu", " electrons")):
            value = getattr(self, name)
            require(0.0 <= value < 1e5, f"SensorNoise's {name}", value, f"0{unit} or more")
        require(1 <= self.bits <= 16, "SensorNoise's bits", self.bits, "1 to 16")
        highest = 2**self.bits - 2
        require(0 <= black <= highest, "SensorNoise's black_level", black, f"0 to {highest}")
        seed = self.sensor_seed
        require(0 <= seed <= MAX_SEED, "SensorNoise's sensor_seed", seed, f"0 to {MAX_SEED}")

    def system_gain(self, gain: float = 1.0) -> float:
        """System gain K at a gain: digital value per electron."""
        return gain * (2**self.bits - 1 - self.black_level) / self.full_well

    def fixed_pattern(
        self, shape: tuple[int, int], camera: int
    ) -> tuple[Float[np.ndarray, "n w"], Float[np.ndarray, "n w"]]:
        """Response of each site relative to the mean, and its offset [electrons].

        Args:
            shape: Shape of the sites; three times the image's height without a Bayer filter.
            camera: Index of the camera in the capsule.
        """
        first, second = (
            _core.standard_normal(shape, self.sensor_seed, _FIXED + 2 * camera + k) for k in (0, 1)
        )
        response = np.maximum(1.0 + self.prnu * first, 0.0)
        return response.astype(np.float32), (self.dsnu * second).astype(np.float32)

    def params(self, setup: CameraSetup) -> dict[str, object]:
        """Converter parameters and fixed pattern."""
        camera, planes = setup.camera, 3 if setup.find(BayerFilter) is None else 1
        return {
            "full_well": self.full_well,
            "read_noise": self.read_noise,
            "white": float(2**self.bits - 1),
            "black": float(self.black_level),
            "pattern": self.fixed_pattern(
                (planes * camera.height, camera.width), setup.camera_index
            ),
        }
