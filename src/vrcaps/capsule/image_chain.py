"""Image chain of a capsule: lens, sensor and image processor as built, and how units differ."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.units import MM

Triple = tuple[float, float, float]

_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_Spread = Annotated[float, Range(min=0.0, max=0.5)]


@dataclass(frozen=True)
class UnitVariation:
    """Differences between the units of one model of capsule.

    Each value is the standard deviation of a normal distribution truncated at two standard
    deviations, sampled for each unit by its seed. Manufacturers publish none: they are estimates.

    Attributes:
        white_balance: Of the natural logarithm of the gains of red and blue.
        color_matrix: Of each element of the color matrix off its diagonal; gray is kept.
        lens_shading: Of the lens shading's coefficients, relative.
        focus: Of the natural logarithm of the distance in focus.
        led: Of the natural logarithm of each LED's intensity.
        led_color: Of the natural logarithm of each LED's red and blue relative to green.
        exposure: Of the natural logarithm of the automatic exposure's target. Mean luminances of
            461 images of WCEBleedGen have 0.39; half of that variance is attributed to units, half
            to the `exposure_tolerance` of each frame.
        denoising: Of the natural logarithm of the widths of the low-pass filters, with the same
            deviation for both, as processors are set to smooth images more or less.
    """

    white_balance: _Spread = 0.08
    color_matrix: _Spread = 0.02
    lens_shading: _Spread = 0.25
    focus: _Spread = 0.12
    led: _Spread = 0.15
    led_color: _Spread = 0.015
    exposure: _Spread = 0.25
    denoising: _Spread = 0.3

    def __post_init__(self) -> None:
        check_fields(self, of="UnitVariation")


EQUAL_UNITS = UnitVariation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Units without differences."""


@dataclass(frozen=True)
class ImageChain:
    """Lens, sensor and image processor of a capsule's cameras as built, in physical order.

    `vrcaps.camera_pipeline` converts it to effects, whose classes give the equations. The defaults
    are estimates for a generic capsule with a sensor of 320 by 320 pixels, because no manufacturer
    publishes its image chain. They were fitted so that features, spectrum, radial profile and
    chroma of rendered frames approach those of WCEBleedGen (MISAHUB) as distributions.

    Attributes:
        aperture: Diameter of the entrance pupil [m].
        focus_distance: Distance in focus [m].
        lens_shading: k₁, k₂, k₃ of `Vignetting`.
        cosine_power: Power of the cosine of `Vignetting`.
        lateral_color: Magnification of red and of blue relative to green, minus 1.
        bloom_fraction: Fraction of the light scattered by lens and dome; 0 for none.
        bloom_angle: Standard deviation of the halo [rad].
        full_well: Electrons of white.
        read_noise: Standard deviation of reading a site [electrons].
        prnu: Standard deviation of the sites' responses, relative.
        dsnu: Standard deviation of the sites' offsets [electrons].
        bayer_pattern: Colors of 2 by 2 sites in row-major order; empty for three sensors.
        white_balance: Residual gains of red, green and blue.
        response: Response of red, green and blue sites to white.
        color_matrix: Rows of the residual color matrix.
        contrast: Slope of the tone curve at its pivot; 1 for none.
        luma_denoising_px: Standard deviation of the low-pass filter of luma; 0 for none.
        chroma_denoising_px: Standard deviation of the low-pass filter of chroma; 0 for none.
        sharpening: Amount of the unsharp mask; 0 for none.
        sharpening_radius_px: Standard deviation of its filter.
        jpeg_quality: Quality of compression, 1 to 100; 0 for no compression.
        exposure_tolerance: `AutoExposure.tolerance`.
        variation: Differences between units; `EQUAL_UNITS` if there are none.
    """

    aperture: Annotated[float, Range(above=0.0, below=0.01, unit="m")] = field(
        default=0.4 * MM, metadata={"unit": "mm"}
    )
    focus_distance: Annotated[float, Range(above=0.0, unit="m")] = field(
        default=10.0 * MM, metadata={"unit": "mm"}
    )
    lens_shading: Triple = (-1.15, 0.35, 0.0)
    cosine_power: Annotated[float, Range(min=0.0, max=16.0)] = 0.0
    lateral_color: tuple[float, float] = (0.002, -0.002)
    bloom_fraction: Annotated[float, Range(min=0.0, below=1.0)] = 0.12
    bloom_angle: Annotated[float, Range(above=0.0, below=1.0, unit="rad")] = 0.1
    full_well: Annotated[float, Range(min=1.0, max=1e6, unit="electrons")] = 10000.0
    read_noise: Annotated[float, Range(min=0.0, below=1e5, unit="electrons")] = 5.0
    prnu: Annotated[float, Range(min=0.0, below=1.0)] = 0.01
    dsnu: Annotated[float, Range(min=0.0, below=1e5, unit="electrons")] = 3.0
    bayer_pattern: str = "rggb"
    white_balance: Triple = (1.0, 1.0, 1.0)
    response: Triple = (0.6, 1.0, 0.7)
    color_matrix: tuple[Triple, Triple, Triple] = _IDENTITY
    contrast: Annotated[float, Range(min=0.25, max=4.0)] = 1.35
    luma_denoising_px: Annotated[float, Range(min=0.0, max=10.0, unit="px")] = 0.64
    chroma_denoising_px: Annotated[float, Range(min=0.0, max=10.0, unit="px")] = 1.0
    sharpening: Annotated[float, Range(min=0.0, max=10.0)] = 1.8
    sharpening_radius_px: Annotated[float, Range(min=0.3, max=10.0, unit="px")] = 2.0
    jpeg_quality: Annotated[int, Range(min=0, max=100)] = 75
    exposure_tolerance: Annotated[float, Range(min=0.0, max=1.0)] = 0.3
    variation: UnitVariation = field(default_factory=UnitVariation)

    def __post_init__(self) -> None:
        check_fields(self, of="ImageChain")
        allowed = "rggb, bggr, grbg, gbrg or empty"
        is_known = self.bayer_pattern in ("", "rggb", "bggr", "grbg", "gbrg")
        require(is_known, "ImageChain's bayer_pattern", repr(self.bayer_pattern), allowed)
        for name in ("white_balance", "response"):
            values = getattr(self, name)
            is_valid = all(0.01 <= value <= 10.0 for value in values)
            require(is_valid, f"ImageChain's {name}", values, "three numbers from 0.01 to 10")
        is_finite = bool(np.isfinite(self.lens_shading).all())
        require(is_finite, "ImageChain's lens_shading", self.lens_shading, "three finite numbers")
        is_small = all(-0.5 < value < 0.5 for value in self.lateral_color)
        allowed = "two numbers from -0.5 to 0.5"
        require(is_small, "ImageChain's lateral_color", self.lateral_color, allowed)
        is_valid = bool((np.abs(np.array(self.color_matrix, float)) <= 4.0).all())
        allowed = "3 rows of 3 numbers from -4 to 4"
        require(is_valid, "ImageChain's color_matrix", self.color_matrix, allowed)
