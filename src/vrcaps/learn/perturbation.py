"""Perturbations of frames, for tests of robustness: exposure, JPEG, noise, border and crop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import scaled_lens
from vrcaps.core import rng
from vrcaps.core.color import linear_from_srgb, srgb_from_linear
from vrcaps.recording.frame_sequence import EXPOSURE, FrameSequence

if TYPE_CHECKING:
    from jaxtyping import UInt8
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
