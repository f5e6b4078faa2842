"""Augmentation: random crops, flips, and changes of exposure, white balance and gamma."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.config.fields import Range, check_fields
from vrcaps.learn.task import Sample

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

_JITTER = Range(1.0, 10.0)


@dataclass(frozen=True)
class Augmentation:
    """Random changes of training samples. Factors of color are drawn log-uniformly.

    Attributes:
        exposure_jitter: Maximum change of exposure, as a factor: 1.3 is ± 30 %.
        color_jitter: Maximum change of each color channel, as a factor.
        gamma_jitter: Maximum exponent. With 1 for this and both above, colors are not changed.
        min_crop: Minimum side of a random crop, relative to the image; 1 is the whole image.
    """

    exposure_jitter: Annotated[float, _JITTER] = 1.3
    color_jitter: Annotated[float, _JITTER] = 1.25
    gamma_jitter: Annotated[float, _JITTER] = 1.3
    min_crop: Annotated[float, Range(above=0.0, max=1.0)] = 0.6

    def __post_init__(self) -> None:
        check_fields(self)

    def crop(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Crop a random square from a sample and resize it to the sample's size.

        Args:
            sample: `image`, and maps [s s ...], which are resampled by nearest neighbor.
            rng: Random generator for the crop.
        """
        from PIL import Image

        size = sample["image"].shape[0]
        side = size * rng.uniform(self.min_crop, 1.0)
        left, top = rng.uniform(0.0, size - side, 2)
        centers = (np.arange(size) + 0.5) * side / size
        part = np.ix_((top + centers).astype(int), (left + centers).astype(int))
        box = (left, top, left + side, top + side)
        image = Image.fromarray(sample["image"])
        large = np.asarray(image.resize((size, size), Image.Resampling.BILINEAR, box=box))
        maps = {
            name: np.ascontiguousarray(array[part])
            if np.shape(array)[:2] == (size, size)
            else array
            for name, array in sample.items()
        }
        return maps | {"image": large}

    def recolor(
        self, image: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Apply a random exposure, white balance and gamma to an image."""
        exposure = self.exposure_jitter ** rng.uniform(-1.0, 1.0)
        gain = exposure * self.color_jitter ** rng.uniform(-1.0, 1.0, 3)
        return with_gain(image, gain, self.gamma_jitter ** rng.uniform(-1.0, 1.0))


def flip(sample: Sample, axis: int) -> Sample:
    """Flip all maps of a sample along columns (axis 1) or rows (axis 0)."""
    return _with_maps(sample, lambda array: np.flip(array, axis))


def transpose(sample: Sample) -> Sample:
    """Exchange rows and columns of all maps of a sample."""
    return _with_maps(sample, lambda array: np.swapaxes(array, 0, 1))


def random_flip(sample: Sample, rng: np.random.Generator) -> Sample:
    """Flip a sample along rows, columns, both or neither, at random."""
    for axis in (0, 1):
        if rng.random() < 0.5:
            sample = flip(sample, axis)
    return sample


def with_gain(
    image: UInt8[np.ndarray, "h w 3"], gain: Float[np.ndarray, " 3"], gamma: float
) -> UInt8[np.ndarray, "h w 3"]:
    """Apply a factor per color channel and a gamma to an image."""
    table = np.arange(256)[:, None] / 255.0
    changed = np.clip(255.0 * gain * table**gamma + 0.5, 0, 255).astype(np.uint8)
    return np.stack([changed[image[..., k], k] for k in range(3)], axis=-1)


def _with_maps(sample: Sample, change: Callable[[NDArray], NDArray]) -> Sample:
    return {
        name: np.array(change(array), order="C") if getattr(array, "ndim", 0) >= 2 else array
        for name, array in sample.items()
    }
