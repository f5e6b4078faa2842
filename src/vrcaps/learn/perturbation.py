"""Perturbations of frames for tests of robustness, and degradations of training images.

Perturbations are exposure, JPEG, noise, border and crop; a degradation is that of a camera and a
recorder: blur, mosaic, noise and JPEG.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import scaled_lens
from vrcaps.core import rng
from vrcaps.core.color import linear_from_srgb, srgb_from_linear
from vrcaps.core.fields import Range, check_fields
from vrcaps.recording.frame_sequence import EXPOSURE, FrameSequence

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Perturbation:
    """Change of a frame that keeps its meaning.

    Attributes:
        name: Name in tables.
        exposure: Factor of linear brightness; values above the range are clipped.
        jpeg: JPEG quality, 1 to 100; 0 for none.
        noise: Standard deviation of Gaussian noise [of 255].
        border: Width of an added black border, relative to each side.
        crop: Side of the central part that remains, relative to the image.
    """

    name: str
    exposure: float = 1.0
    jpeg: int = 0
    noise: float = 0.0
    border: float = 0.0
    crop: float = 1.0

    def sequence(self, sequence: FrameSequence) -> FrameSequence:
        """Return a sequence with perturbed frames; labels and lens follow border and crop.

        A changed exposure is unknown to the task: NaN.
        """
        framed = self.framing(sequence)
        if self.exposure != 1.0:
            unknown = np.full(len(sequence), np.nan)
            framed = replace(framed, values={**framed.values, EXPOSURE: unknown})

        def load(channel: str, index: int) -> NDArray:
            image = framed.load(channel, index)
            return self.recolored(image, index) if channel == "rgb" else image

        return replace(framed, load=load)

    def framing(self, sequence: FrameSequence) -> FrameSequence:
        """Return a sequence with border and crop alone; all channels and the lens follow."""
        if self.border == 0.0 and self.crop == 1.0:
            return sequence

        def load(channel: str, index: int) -> NDArray:
            return self._framed(sequence.load(channel, index))

        return replace(sequence, load=load, camera=self._camera(sequence.camera))

    def recolored(
        self, image: UInt8[np.ndarray, "h w 3"], index: int
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Apply exposure, noise and JPEG to an image; noise depends on the frame's index."""
        if self.exposure != 1.0:
            image = srgb_from_linear(np.clip(self.exposure * linear_from_srgb(image), 0.0, 1.0))
        if self.noise > 0.0:
            draw = rng.stream(index, "learn/perturbation")
            noisy = image + self.noise * draw.standard_normal(image.shape)
            image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return jpeg_image(image, self.jpeg) if self.jpeg else image

    def _margin(self, side: int) -> int:
        """Pixels added at each end of a side; negative if they are removed."""
        return round(self.border * side) - round(0.5 * (1.0 - self.crop) * side)

    def _framed(self, image: NDArray) -> NDArray:
        margins = [self._margin(side) for side in image.shape[:2]]
        inner = tuple(
            slice(max(0, -m), n - max(0, -m)) for m, n in zip(margins, image.shape, strict=False)
        )
        pads = [(max(0, m), max(0, m)) for m in margins] + [(0, 0)] * (image.ndim - 2)
        fill = np.nan if image.dtype.kind == "f" else 0
        return np.pad(image[inner], pads, constant_values=fill)

    def _camera(self, camera: Camera | None) -> Camera | None:
        if camera is None:
            return None
        below, right = self._margin(camera.height), self._margin(camera.width)
        lens = scaled_lens(camera.lens, 1.0, (camera.lens.cx + right, camera.lens.cy + below))
        height, width = camera.height + 2 * below, camera.width + 2 * right
        return replace(camera, lens=lens, width=width, height=height)


PERTURBATIONS = (
    *(Perturbation(f"exposure × {factor:g}", exposure=factor) for factor in (0.1, 0.25, 0.5, 2, 4)),
    Perturbation("JPEG 75", jpeg=75),
    Perturbation("noise 8 / 255", noise=8.0),
    Perturbation("border 10 %", border=0.1),
    Perturbation("crop 80 %", crop=0.8),
)
"""Perturbations of `vrcaps evaluate TASK --perturb`."""


def jpeg_image(image: UInt8[np.ndarray, "h w 3"], quality: int) -> UInt8[np.ndarray, "h w 3"]:
    """Compress an image as JPEG with 4:2:0 chroma, and decompress it."""
    from PIL import Image

    buffer = BytesIO()
    Image.fromarray(image).save(buffer, "jpeg", quality=quality)
    return np.array(Image.open(buffer))


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
