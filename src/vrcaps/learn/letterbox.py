"""Letterbox transform between images and square network inputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Letterbox:
    """Letterbox transform: scaling that keeps the aspect ratio, centered in a padded square.

    Attributes:
        height: Height of the image [px].
        width: Width of the image [px].
        size: Side of the square [px].
    """

    height: int
    width: int
    size: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image within the square [px]."""
        scale = self.size / max(self.height, self.width)
        return max(1, round(scale * self.height)), max(1, round(scale * self.width))

    @property
    def region(self) -> tuple[slice, slice]:
        """Rows and columns of the square that the image covers."""
        height, width = self.shape
        top, left = (self.size - height) // 2, (self.size - width) // 2
        return slice(top, top + height), slice(left, left + width)

    @cached_property
    def pixels(self) -> Int[np.ndarray, "h w 2"]:
        """Column and row of the source pixel nearest each pixel of the image in the square."""
        height, width = self.shape
        rows = ((np.arange(height) + 0.5) * self.height / height).astype(int)
        columns = ((np.arange(width) + 0.5) * self.width / width).astype(int)
        return np.stack(np.meshgrid(columns, rows), axis=-1)

    def to_square(self, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """Convert pixels of the image [... 2] (column, row) to columns and rows of the square."""
        height, width = self.shape
        rows, columns = self.region
        column = (pixels[..., 0] + 0.5) * (width / self.width) - 0.5 + columns.start
        row = (pixels[..., 1] + 0.5) * (height / self.height) - 0.5 + rows.start
        return column, row

    def image(self, image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "s s 3"]:
        """Resize a color image into the square, with black padding; averages when it shrinks."""
        from PIL import Image

        height, width = self.shape
        small = Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR)
        return self.padded(np.asarray(small), 0)

    def nearest(self, values: NDArray, fill: float) -> NDArray:
        """Resample values into the square by nearest neighbor, with padding `fill`."""
        return self.padded(values[self.pixels[..., 1], self.pixels[..., 0]], fill)

    def padded(self, values: NDArray, fill: float) -> NDArray:
        """Pad values of the image region to a square with `fill`."""
        square = np.full((self.size, self.size, *values.shape[2:]), fill, values.dtype)
        square[self.region] = values
        return square

    def back(self, square: Float[np.ndarray, "s s"]) -> Float[np.ndarray, "h w"]:
        """Resize a map of the square to the size of the image, by linear interpolation."""
        from PIL import Image

        inner = np.ascontiguousarray(square[self.region], np.float32)
        size = (self.width, self.height)
        return np.asarray(Image.fromarray(inner).resize(size, Image.Resampling.BILINEAR))
