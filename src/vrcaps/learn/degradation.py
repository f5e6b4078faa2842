"""Degradations of training images by a camera and a recorder: blur, mosaic, noise and JPEG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.config.fields import Range, check_fields
from vrcaps.learn.perturbation import jpeg_image

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

_PROBABILITY = 0.5
"""Probability of each degradation."""
_BEST_JPEG = 95
_CROSS = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4.0
_SQUARE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0
"""Kernels of bilinear demosaicing for green, and for red and blue."""


@dataclass(frozen=True)
class Degradation:
    """Random degradations of small training images, each with probability ½, in this order.

    Attributes:
        max_blur: Maximum standard deviation of a Gaussian blur [px]; 0 for none.
        mosaic: Whether a Bayer filter is applied and demosaiced bilinearly.
        max_noise: Maximum standard deviation of Gaussian noise [of 255]; 0 for none.
        min_jpeg: Minimum JPEG quality, up to 95; 0 for no compression.
    """

    max_blur: Annotated[float, Range(0.0, 10.0)] = 0.0
    mosaic: bool = False
    max_noise: Annotated[float, Range(0.0, 100.0)] = 0.0
    min_jpeg: Annotated[int, Range(0, 95)] = 0

    def __post_init__(self) -> None:
        check_fields(self)

    def apply(
        self, image: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Degrade an image."""
        from scipy.ndimage import gaussian_filter

        if self == Degradation():
            return image
        is_used = rng.random(4) < _PROBABILITY
        blur, noise, quality = rng.uniform(0.0, 1.0, 3)
        values = image.astype(float)
        if is_used[0] and self.max_blur > 0.0:
            values = gaussian_filter(values, (blur * self.max_blur, blur * self.max_blur, 0.0))
        if is_used[1] and self.mosaic:
            values = demosaiced(values)
        if is_used[2] and self.max_noise > 0.0:
            values = values + noise * self.max_noise * rng.standard_normal(values.shape)
        result = np.clip(np.rint(values), 0, 255).astype(np.uint8)
        if is_used[3] and self.min_jpeg > 0:
            result = jpeg_image(
                result, round(self.min_jpeg + quality * (_BEST_JPEG - self.min_jpeg))
            )
        return result


def demosaiced(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Keep one color of each pixel in a Bayer pattern (RGGB); interpolate the others bilinearly.

    At the border the pattern is mirrored, which keeps its colors in place.
    """
    from scipy.ndimage import convolve

    row, column = np.indices(image.shape[:2]) % 2
    known = [(row == 0) & (column == 0), row != column, (row == 1) & (column == 1)]
    kernels = (_SQUARE, _CROSS, _SQUARE)
    planes = [
        convolve(np.where(mask, image[..., k], 0.0), kernels[k], mode="mirror")
        for k, mask in enumerate(known)
    ]
    return np.stack(planes, axis=-1)
