"""Effects of the image signal processor (ISP).

White balance and color matrix act on linear colors; tone curve, denoising and sharpening on the
sRGB-encoded image; JPEG compression comes last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect
from vrcaps.core.color import LUMINANCE
from vrcaps.core.errors import require
from vrcaps.core.fields import Range

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]

MAX_ELEMENT = 4.0
"""Maximum absolute value of an element of a color matrix."""
MAX_FILTER_WIDTH = 10.0
"""Maximum standard deviation of a filter of `Denoising` [px]."""


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
        super().__post_init__()
        for name in ("gains", "response"):
            values = getattr(self, name)
            is_valid = all(0.0 < v < 100.0 for v in values)
            require(is_valid, f"WhiteBalance's {name}", values, "three numbers above 0 to 100")

    def params(self, setup: CameraSetup) -> tuple[Triple, Triple]:
        """Gains and response."""
        return self.gains, self.response


def saturation_matrix(saturation: float) -> Matrix:
    """Matrix that scales the distance of linear colors from gray of equal luminance (BT.709)."""
    matrix = saturation * np.eye(3) + (1.0 - saturation) * LUMINANCE
    red, green, blue = (tuple(row) for row in matrix.round(6).tolist())
    return red, green, blue


@dataclass(frozen=True)
class ColorMatrix(ImageEffect):
    """Matrix that converts the sensor's balanced linear colors to those of the image.

    The renderer's colors are those of an ideally corrected sensor, so this is the residual error
    and the saturation of the manufacturer's matrix. Rows that sum to 1 keep gray.

    Attributes:
        matrix: Rows of red, green and blue; each value between -4 and 4.
    """

    matrix: Matrix

    name = "color_matrix"
    severities = (
        None,
        {"matrix": saturation_matrix(1.1)},
        {"matrix": saturation_matrix(1.2)},
        {"matrix": saturation_matrix(1.35)},
        {"matrix": saturation_matrix(1.6)},
    )

    def __post_init__(self) -> None:
        values = np.array(self.matrix, float)
        is_valid = values.shape == (3, 3) and bool((np.abs(values) <= MAX_ELEMENT).all())
        require(is_valid, "ColorMatrix's matrix", self.matrix, "3 rows of 3 numbers from -4 to 4")

    def params(self, setup: CameraSetup) -> Matrix:
        """The matrix by rows."""
        return self.matrix


@dataclass(frozen=True)
class ToneCurve(ImageEffect):
    """S-shaped curve of the sRGB-encoded image, which compresses shadows and highlights.

    A value v of 0 to 1 becomes ``1 / (1 + c ((1 − v) / v)^a)``, the log-logistic curve. With
    ``c = (p / (1 − p))^(a − 1)`` it keeps black, white and the pivot p, where its slope is a.

    Attributes:
        contrast: a; below 1 the curve flattens.
        pivot: p, encoded; 0.46 is the encoded value of the linear value 0.18.
    """

    contrast: Annotated[float, Range(min=0.25, max=4.0)]
    pivot: Annotated[float, Range(min=0.05, max=0.95)] = 0.46

    name, short = "tone_curve", "tone"
    severities = (
        None,
        {"contrast": 1.1},
        {"contrast": 1.2},
        {"contrast": 1.35},
        {"contrast": 1.6},
    )

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Exponent a and factor c."""
        odds = self.pivot / (1.0 - self.pivot)
        return self.contrast, odds ** (self.contrast - 1.0)


@dataclass(frozen=True)
class Denoising(ImageEffect):
    """Low-pass filters of luma and chroma (BT.601) against noise and the mosaic's false colors.

    The filters are Gaussians over the pixels that the lens illuminates.

    Attributes:
        luma: Standard deviation for luma [px]; 0 for none.
        chroma: Standard deviation for chroma [px]; 0 for none.
    """

    luma: Annotated[float, Range(min=0.0, max=MAX_FILTER_WIDTH, unit="px")]
    chroma: Annotated[float, Range(min=0.0, max=MAX_FILTER_WIDTH, unit="px")]

    name = "denoising"
    severities = (
        None,
        {"luma": 0.0, "chroma": 0.8},
        {"luma": 0.4, "chroma": 1.2},
        {"luma": 0.7, "chroma": 1.8},
        {"luma": 1.1, "chroma": 3.0},
    )

    def params(self, setup: CameraSetup) -> tuple[float, float]:
        """Standard deviations for luma and chroma [px]."""
        return self.luma, self.chroma


@dataclass(frozen=True)
class Sharpening(ImageEffect):
    """Unsharp mask of luma, with a halo along edges.

    Luma gains ``amount`` times its difference d from a Gaussian-filtered copy; only the part of d
    beyond the threshold counts (coring), so that noise is not amplified.

    Attributes:
        amount: Factor on the difference.
        sigma: Standard deviation of the filter [px].
        threshold: Threshold of the difference [1/255 of white].
    """

    amount: Annotated[float, Range(min=0.0, max=10.0)]
    sigma: Annotated[float, Range(min=0.3, max=10.0, unit="px")] = 1.0
    threshold: Annotated[float, Range(min=0.0, max=255.0)] = 1.0

    name, short = "sharpening", "sharp"
    severities = (
        None,
        {"amount": 0.4},
        {"amount": 0.8},
        {"amount": 1.3},
        {"amount": 2.0},
    )

    def params(self, setup: CameraSetup) -> tuple[float, float, float]:
        """Amount, standard deviation [px] and threshold."""
        return self.amount, self.sigma, self.threshold


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
