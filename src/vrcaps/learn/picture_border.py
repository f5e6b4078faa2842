"""Parts of an endoscope's picture that show no tissue: black border, corners, inserts and text.

Depth prediction excludes border and inserts, in `vrcaps predict` and in `vrcaps evaluate`, and
compensates unknown exposure.
Recordings of vrcaps have no border to exclude: their cameras state the extent of the image.

Overlays differ between hospitals and classes, so that a network can classify by them without using
the tissue. Classification hides them in every image at the same position, whether they are present
or not: a mask that followed the image would reveal them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
import scipy
from torch import Tensor

from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import scaled_lens
from vrcaps.camera.lens import LensEquidistant
from vrcaps.core.color import linear_from_srgb
from vrcaps.core.errors import InputError
from vrcaps.recording.frame_sequence import EXPOSURE

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8
    from numpy.typing import NDArray

    from vrcaps.recording.frame_sequence import FrameSequence


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


BLACK = 24
"""Maximum channel value of the border around an endoscope's picture [of 255], unless it is dark."""
_DARK_FRACTION, _BRIGHT = 0.2, 0.98
"""Level of black in a dark image, relative to this quantile of its pixels."""
_MEDIAN_BRIGHTNESS = 0.06
"""Median linear brightness of an image: geometric mean of eight recorded frames, a rough value; in
C3VD, to which a value of 0.08 was compared first, it gives a scale of 1.05."""
_DARKEST = 1e-4
"""Minimum median brightness, a third of a step of 8 bits."""
_FILLED = 0.02
"""Minimum fraction of brighter pixels of a row or column that belongs to the picture."""
_MAX_INSERT = 0.3
"""Maximum fraction of non-tissue colors that are inserts; larger fractions are due to the light,
such as narrow-band imaging."""
LENS_NEEDED = (
    "Depth requires the lens of the camera that took the images. Give --capsule NAME (a name of "
    "the catalog such as colonoscope, or a device file), or --fov DEGREES for an assumed lens, "
    "such as --fov 140."
)

Overlay = Literal["corners", "insert", "text"]
_RADIUS = 0.46
"""Half axes of the visible ellipse of an image, relative to its sides: it lies within the octagons
and circles of HyperKvasir, Kvasir-SEG and WCEBleedGen."""
_INSERT = (0.56, 0.45)
"""Top and right edge of the lower left part where HyperKvasir shows the endoscope's position."""
_TEXT = 0.27
"""Right edge of the left part where HyperKvasir and Kvasir-SEG show date and name."""


@dataclass(frozen=True)
class PictureView:
    """Part of an image that is the network's input.

    Attributes:
        image: Colors of the part, uint8 [h w 3].
        camera: Camera of the part; None if it is not known.
        region: Rows and columns of the part in the image.
        shape: Height and width of the image [px].
        is_insert: Mask of the device's inserts within the part [h w].
        log_scale: ln of the factor of predicted distances, see `log_scale_of`; 0 at a known
            exposure.
        exposure: Exposure relative to the camera's own, see `exposure_of`; 1 if it is unknown.
    """

    image: UInt8[np.ndarray, "h w 3"]
    camera: Camera | None
    region: tuple[slice, slice]
    shape: tuple[int, int]
    is_insert: Bool[np.ndarray, "h w"]
    log_scale: float = 0.0
    exposure: float = 1.0

    def whole(self, values: NDArray) -> NDArray:
        """Convert a map of the part to the whole image, with 0 outside it and in inserts."""
        whole = np.zeros((*self.shape, *values.shape[2:]), values.dtype)
        whole[self.region] = np.where(self.is_insert, 0, values)
        return whole


def exposure_of(sequence: FrameSequence, index: int) -> float:
    """Exposure of a frame relative to the camera's own; 1 if it is fixed or unknown."""
    if EXPOSURE not in sequence.values or not _knows_exposure(sequence):
        return 1.0
    return float(np.nan_to_num(sequence.values[EXPOSURE][index], nan=1.0))


def _knows_exposure(sequence: FrameSequence) -> bool:
    """Whether the exposure of a sequence is known: stated, or fixed as in a recording."""
    if EXPOSURE in sequence.values:
        return bool(np.isfinite(sequence.values[EXPOSURE]).any())
    return sequence.episode is not None


def log_scale_of(image: UInt8[np.ndarray, "h w 3"]) -> float:
    """Logarithm of the factor of distances in an image of unknown exposure.

    Brightness falls with the square of distance, so an image that is four times as bright as
    recordings on average has an exposure four times as long, or shows tissue at half the distance.
    The first is assumed. Distances then do not depend on exposure. They are right if the wall is as
    far and as pale as in recordings on average: a prior instead of a measurement.

    Args:
        image: Tissue without the border.
    """
    is_tissue = image.max(axis=-1) > _black_level(image)
    if not is_tissue.any():
        return 0.0
    median = float(np.median(linear_from_srgb(image).mean(axis=-1)[is_tissue]))
    return 0.5 * math.log(max(median, _DARKEST) / _MEDIAN_BRIGHTNESS)


def _black_level(image: UInt8[np.ndarray, "h w 3"]) -> float:
    """Channel value up to which pixels are black; lower than `BLACK` in dark images."""
    return min(float(BLACK), _DARK_FRACTION * float(np.quantile(image.max(axis=-1), _BRIGHT)))


def view_of(
    sequence: FrameSequence,
    index: int,
    field_of_view: float | None = None,
    *,
    predicts_lengths: bool = False,
) -> PictureView:
    """Return the part of a frame's image that is the input of a network.

    Args:
        sequence: Sequence of the frame.
        index: Index of the frame.
        field_of_view: Angle across the width of the part [rad], for an assumed lens if the camera
            is not known.
        predicts_lengths: Whether the task infers lengths. The part is then the tissue alone, and
            its exposure is stated, because brightness is a cue of distance.

    Raises:
        InputError: If the camera makes images of another size, or the image cannot be read.
        OSError: If the image cannot be read.
    """
    image = sequence.image("rgb", index)
    camera, (height, width) = sequence.camera, image.shape[:2]
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise InputError(
            f"The image has {width} x {height} pixels, but the camera {camera.name!r} makes "
            f"{camera.width} x {camera.height}. Give a capsule with images of this size (--capsule "
            "NAME or FILE), or an assumed lens (--fov DEGREES)."
        )
    exposure = exposure_of(sequence, index) if predicts_lengths else 1.0
    is_recording = sequence.episode is not None and camera in sequence.episode.cameras
    if predicts_lengths and not is_recording:
        view = tissue_view(image, camera, field_of_view)
        is_known = _knows_exposure(sequence)
        return replace(view, log_scale=0.0, exposure=exposure) if is_known else view
    if camera is None and field_of_view is not None:
        camera = assumed_camera(width, height, field_of_view)
    whole, nowhere = (slice(0, height), slice(0, width)), np.zeros((height, width), bool)
    is_scaled = predicts_lengths and not _knows_exposure(sequence)
    log_scale = log_scale_of(image) if is_scaled else 0.0
    return PictureView(image, camera, whole, (height, width), nowhere, log_scale, exposure)


def tissue_view(
    image: UInt8[np.ndarray, "h w 3"],
    camera: Camera | None = None,
    field_of_view: float | None = None,
) -> PictureView:
    """Return the tissue of an endoscope's picture: without black border, inserts marked.

    `vrcaps predict`, `vrcaps evaluate` and the benchmark on real images use this function.

    Args:
        image: The whole image.
        camera: Its camera, of the same size; None if it is not known.
        field_of_view: Angle across the width of the part [rad], for an assumed lens instead.
    """
    rows, columns = bright_part(image)
    part = np.ascontiguousarray(image[rows, columns])
    foreign = inserts(part)
    if camera is not None:
        camera = part_of(camera, rows, columns)
    elif field_of_view is not None:
        camera = assumed_camera(part.shape[1], part.shape[0], field_of_view)
    is_insert = foreign & (foreign.mean() < _MAX_INSERT)
    shape = image.shape[:2]
    return PictureView(part, camera, (rows, columns), shape, is_insert, log_scale_of(part))


def bright_part(image: UInt8[np.ndarray, "h w 3"]) -> tuple[slice, slice]:
    """Rows and columns of an image without the almost black ones at its edges.

    All rows and columns if the whole image is black.
    """
    bright = image.max(axis=-1) > _black_level(image)
    rows, columns = (np.flatnonzero(bright.mean(axis=axis) > _FILLED) for axis in (1, 0))
    if not rows.size or not columns.size:
        return slice(0, image.shape[0]), slice(0, image.shape[1])
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def tissue_of(image: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Mask of the field of view: the largest bright region, without holes."""
    label, count = scipy.ndimage.label(image.max(axis=-1) > _black_level(image))
    if not count:
        return np.zeros(image.shape[:2], bool)
    largest = label == 1 + int(np.bincount(label.ravel())[1:].argmax())
    return scipy.ndimage.binary_fill_holes(largest)


def inserts(
    image: UInt8[np.ndarray, "h w 3"], within: Bool[np.ndarray, "h w"] | None = None
) -> Bool[np.ndarray, "h w"]:
    """Mask of boxes that the device overlays on a picture, by colors that tissue does not have.

    Args:
        image: Color image; pixels with more green or blue than red are not tissue.
        within: Mask of the search region; None for the whole image.
    """
    red, green, blue = (image[..., channel].astype(np.int16) for channel in range(3))
    foreign = (green > 1.15 * red + 8) | (blue > 1.1 * red + 8)
    width = image.shape[1]
    if within is not None:
        foreign &= within
        columns = np.flatnonzero(within.any(axis=0))
        width = int(columns[-1] - columns[0] + 1)
    foreign = scipy.ndimage.binary_opening(foreign, iterations=max(2, width // 100))
    return np.asarray(scipy.ndimage.binary_dilation(foreign, iterations=max(3, width // 50)))


def assumed_camera(width: int, height: int, field_of_view: float) -> Camera:
    """Create a camera with an ideal equidistant lens and a centered principal point.

    Args:
        width: Width of the images [px].
        height: Height of the images [px].
        field_of_view: Angle from the left to the right edge [rad].

    Raises:
        InputError: If the angle is not possible.
    """
    if not 0.0 < field_of_view < 2.0 * math.pi:
        given = f"{math.degrees(field_of_view):g}"
        raise InputError(f"--fov is {given} degrees. Allowed: above 0 to below 360 degrees.")
    focal = width / field_of_view
    widest = min(0.5 * math.hypot(width, height) / focal, math.pi)
    lens = LensEquidistant(
        focal=focal, cx=0.5 * (width - 1), cy=0.5 * (height - 1), max_angle=widest
    )
    return Camera("assumed", lens, width, height)


def horizontal_field(camera: Camera) -> float:
    """Angle [rad] between the leftmost and the rightmost ray of a camera's middle row."""
    columns = np.arange(camera.width, dtype=float)
    pixels = np.stack([columns, np.full(camera.width, 0.5 * (camera.height - 1))], axis=-1)
    rays = camera.lens.unproject(pixels)
    known = rays[np.isfinite(rays).all(axis=-1)]
    ends = np.arctan2(np.hypot(known[:, 0], known[:, 1]), known[:, 2]) * np.sign(known[:, 0])
    return float(np.ptp(ends))


@lru_cache(maxsize=64)
def tissue_mask(height: int, width: int, overlays: tuple[Overlay, ...]) -> Bool[np.ndarray, "h w"]:
    """Mask of the pixels that are not hidden by the overlays.

    Args:
        height: Height of the image [px].
        width: Width of the image [px].
        overlays: `corners` keeps the largest ellipse that both capsules and endoscopes show,
            `insert` hides the lower left, `text` the left.
    """
    y = ((np.arange(height) + 0.5) / height)[:, None]
    x = (np.arange(width) + 0.5) / width
    mask = np.ones((height, width), bool)
    if "corners" in overlays:
        mask &= (x - 0.5) ** 2 + (y - 0.5) ** 2 <= _RADIUS**2
    if "insert" in overlays:
        mask &= (y < _INSERT[0]) | (x > _INSERT[1])
    if "text" in overlays:
        mask &= x > _TEXT
    mask.setflags(write=False)
    return mask


def part_of(camera: Camera, rows: slice, columns: slice) -> Camera:
    """Camera that sees some rows and columns of a camera's images."""
    width, height = columns.stop - columns.start, rows.stop - rows.start
    if (width, height) == (camera.width, camera.height):
        return camera
    center = (camera.lens.cx - columns.start, camera.lens.cy - rows.start)
    lens = scaled_lens(camera.lens, 1.0, center)
    return replace(camera, lens=lens, width=width, height=height)
