"""Photographs and video frames of endoscopes: reading, and the mask of the usable mucosa.

The mask excludes the black border, overlays, highlights and darkness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import LUMA_WEIGHTS
from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.files import file_sha256
from vrcaps.core.names import listed
from vrcaps.formats.shared.stored_images import read_rgb
from vrcaps.learn.picture_border import BLACK, inserts

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

IMAGES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
"""File name extensions of images."""

VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm")
"""File name extensions of videos."""


@dataclass(frozen=True)
class Photo:
    """Endoscopic image.

    Attributes:
        name: File name; for a video, with the frame index.
        rgb: sRGB values.
        sha256: Checksum of the file.
    """

    name: str
    rgb: UInt8[np.ndarray, "h w 3"]
    sha256: str = ""


def read_photos(paths: Sequence[Path], *, num_frames: int = 8) -> list[Photo]:
    """Read all images of files and folders, sorted by name within a folder.

    Args:
        paths: Images, videos, or folders of them (without their subfolders).
        num_frames: Frames to read from each video, evenly spaced.

    Raises:
        InputError: If a path is missing, contains no image, or cannot be read as one.
    """
    if num_frames < 1:
        raise InputError(f"The number of frames of a video is {num_frames}. Allowed: 1 or more.")
    photos = [photo for path in paths for file in _files(path) for photo in _read(file, num_frames)]
    if not photos:
        raise InputError("No photograph is given. Give pictures, videos or folders of them.")
    return photos


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    known = IMAGES + VIDEOS
    files = [file for file in listed(path, "*") if file.suffix.lower() in known]
    if not files:
        raise InputError(f"Folder {path} contains no photograph. Allowed: {', '.join(known)}.")
    return files


def _read(path: Path, num_frames: int) -> list[Photo]:
    if not path.is_file():
        raise InputError(f"No file at {path}. Give pictures, videos or folders of them.")
    if path.suffix.lower() in VIDEOS:
        return _read_video(path, num_frames)
    if path.suffix.lower() not in IMAGES:
        raise InputError(f"{path} is not a picture. Allowed: {', '.join(IMAGES + VIDEOS)}.")
    return [Photo(path.name, read_rgb(path), file_sha256(path))]


def _read_video(path: Path, num_frames: int) -> list[Photo]:
    av = import_extra("av", "video")

    with reading(f"the video {path}"):
        with av.open(str(path)) as container:
            total = sum(1 for _ in container.decode(video=0))
        wanted = set(np.unique(np.linspace(0, total - 1, num_frames).astype(int)).tolist())
        with av.open(str(path)) as container:
            frames = [
                (index, frame.to_ndarray(format="rgb24"))
                for index, frame in enumerate(container.decode(video=0))
                if index in wanted
            ]
    if not frames:
        raise InputError(f"The video {path} has no frame. Give another.")
    digest = file_sha256(path)
    return [Photo(f"{path.name}, frame {index}", rgb, digest) for index, rgb in frames]


_DARK = 45  # brightest channel of the dark lumen, where noise hides the wall
_HIGHLIGHT = 245.0 / 255.0  # minimum of the brightest 5 %: certain highlights (Arnold 2010: T1)
_SUSPECT = 210.0 / 255.0  # minimum value of pixels left out of the local color
_GROWTH = 2.2  # minimum ratio of green and blue light in a highlight to its surroundings
_PALING = 1.35  # minimum ratio of least over greatest channel to that of the surroundings
_WINDOW = 0.1  # side of the median's window, relative to the field
_GROW = 1 / 140  # dilation by the glow around highlights, relative to the field


@dataclass(frozen=True)
class FieldOfView:
    """Regions of a photograph.

    Attributes:
        field: Inside the endoscope's field, without overlaid boxes.
        highlight: Highlights and overlaid text, with their glow.
        dark: Too dark to see the wall.
        width: Width of the field [px].
    """

    field: Bool[np.ndarray, "h w"]
    highlight: Bool[np.ndarray, "h w"]
    dark: Bool[np.ndarray, "h w"]
    width: int

    @property
    def usable(self) -> Bool[np.ndarray, "h w"]:
        """Pixels where the wall is visible."""
        return self.field & ~self.highlight & ~self.dark


def field_of_view(rgb: UInt8[np.ndarray, "h w 3"]) -> FieldOfView:
    """Segment border, overlays, highlights and darkness.

    The border is black and connected to the image border; the field is the largest bright region,
    less a rim of 2 % of its width, where lenses blur. Boxes overlaid by the device are detected by
    colors that tissue does not have: more green or blue than red.
    """
    label = import_extra("skimage.measure", "organs", package="scikit-image").label

    brightest = rgb.max(axis=2)
    bright = scipy.ndimage.binary_opening(brightest > BLACK, iterations=2)
    if not bright.any():
        nothing = np.zeros(rgb.shape[:2], bool)
        return FieldOfView(nothing, nothing, nothing, 0)
    part = np.asarray(label(bright, connectivity=1))
    largest = part == 1 + np.argmax(np.bincount(part.ravel())[1:])
    filled = np.asarray(scipy.ndimage.binary_fill_holes(largest))
    columns = np.flatnonzero(filled.any(axis=0))
    width = int(columns[-1] - columns[0] + 1)
    foreign = inserts(rgb, filled)
    framed = filled.all()  # an image without a border has no rim
    rim = 0 if framed else max(2, round(0.02 * width))
    field = filled & np.logical_not(foreign)
    depth = np.asarray(scipy.ndimage.distance_transform_edt(np.pad(field, 1)))[1:-1, 1:-1]
    field = np.asarray(depth > rim, bool)
    dark = (
        np.asarray(scipy.ndimage.binary_opening(scipy.ndimage.uniform_filter(brightest, 5) < _DARK))
        & field
    )
    return FieldOfView(field, highlights(rgb, field, width) & field, dark, width)


def highlights(
    rgb: UInt8[np.ndarray, "h w 3"], field: Bool[np.ndarray, "h w"], width: int
) -> Bool[np.ndarray, "h w"]:
    """Detect specular highlights by the two steps of Arnold et al. (2010), section 2.

    First by brightness: luma, or green and blue scaled to luma by the ratio of their 95th
    percentiles (tissue is poor in both, a reflection of the lamp is not). Then by contrast with the
    local median of pixels that are not suspect: a highlight adds white light, so green and blue
    both double and the color pales. Highlights are dilated by the glow around them.

    Arnold M., Ghosh A., Ameling S., Lacey G. Automatic segmentation and inpainting of specular
    highlights for endoscopic imaging. EURASIP J. Image Video Process. 2010, 814319.

    Args:
        rgb: The photograph.
        field: Region to search.
        width: Width of the field [px]; sizes scale with it.
    """
    if not field.any():
        return np.zeros_like(field)
    image = rgb.astype(np.float32) / 255.0
    luma = image @ LUMA_WEIGHTS.astype(np.float32)
    sure, suspect = (_bright(image, luma, field, limit) for limit in (_HIGHLIGHT, _SUSPECT))
    local = _local_color(image, field & ~suspect, max(5, round(_WINDOW * width)))
    light, around = (np.maximum(part, 0.02) ** 2.2 for part in (image, local))
    growth = (light / around)[..., 1:].min(axis=2)
    pale, pale_around = (part.min(axis=2) / part.max(axis=2) for part in (light, around))
    pales = pale > _PALING * pale_around
    mask = (sure | ((growth > _GROWTH) & pales & (luma > 0.45))) & field
    return scipy.ndimage.binary_dilation(mask, iterations=max(1, round(_GROW * width)))


def _bright(image, luma, field, limit: float) -> Bool[np.ndarray, "h w"]:
    """Pixels whose luma, scaled green or scaled blue is above a limit."""
    high = float(np.percentile(luma[field], 95.0))
    bright = luma > limit
    for channel in (1, 2):
        ratio = float(np.percentile(image[field, channel], 95.0)) / max(high, 1e-3)
        bright |= image[..., channel] > max(ratio, 0.3) * limit
    return bright


def _local_color(image, known, window: int) -> Float[np.ndarray, "h w 3"]:
    """Local median color of the known pixels; large windows use a quarter of the resolution."""
    step = max(1, window // 12)
    filled = fill(image, known)[::step, ::step]
    size = max(3, window // step)
    small = np.stack(
        [scipy.ndimage.median_filter(filled[..., k], size, mode="nearest") for k in range(3)],
        axis=2,
    )
    shape = image.shape[:2]
    row, column = np.meshgrid(
        np.arange(shape[0]) / step, np.arange(shape[1]) / step, indexing="ij", sparse=False
    )
    return np.stack(
        [
            scipy.ndimage.map_coordinates(small[..., k], [row, column], order=1, mode="nearest")
            for k in range(3)
        ],
        axis=2,
    )


def fill(
    image: Float[np.ndarray, "h w c"], known: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w c"]:
    """Fill unknown pixels smoothly from their surroundings by pull-push.

    Known pixels are averaged to half the size until all are known, and the averages are copied
    back into the gaps (Gortler et al. 1996, The Lumigraph, section 3.4). Known pixels do not
    change.

    Args:
        image: Any values.
        known: Valid pixels; at least one.
    """
    if known.all():
        return image
    height, width = known.shape
    pad = ((0, height % 2), (0, width % 2))
    weight = np.pad(known.astype(np.float32), pad)
    value = np.pad(image * known[..., None], (*pad, (0, 0)))
    small_weight, small = (
        part[::2, ::2] + part[::2, 1::2] + part[1::2, ::2] + part[1::2, 1::2]
        for part in (weight, value)
    )
    seen = small_weight > 0.0
    small = small / np.where(seen, small_weight, 1.0)[..., None]
    if min(seen.shape) > 1 or not seen.all():
        small = fill(small, seen)
    rows = np.clip((np.arange(height) - 0.5) / 2.0, 0.0, seen.shape[0] - 1.0)
    columns = np.clip((np.arange(width) - 0.5) / 2.0, 0.0, seen.shape[1] - 1.0)
    grid = np.meshgrid(rows, columns, indexing="ij")
    raised = np.stack(
        [
            scipy.ndimage.map_coordinates(small[..., k], grid, order=1, mode="nearest")
            for k in range(image.shape[2])
        ],
        axis=2,
    )
    return np.where(known[..., None], image, raised).astype(image.dtype)
