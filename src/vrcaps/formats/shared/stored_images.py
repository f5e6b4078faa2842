"""External image files: read as stored values, written in the expected encoding.

All of them pass through one decoder: it checks the size before pixels are decoded, applies the EXIF
orientation, and converts inks (CMYK) and palettes to colors.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, MissingExtraError, import_extra, reading
from vrcaps.core.files import write_bytes
from vrcaps.recording.frame_files import MAX_PIXELS, decode_image, require_pixels

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Suffixes of readable color images."""
_TIFF = (".tif", ".tiff")
_FORMATS = ("BMP", "JPEG", "PNG", "TIFF", "WEBP")
"""Decoded formats, independent of the suffix: Pillow runs Ghostscript for PostScript."""
_ORIENTATION = 274
"""Tag of EXIF and TIFF for the image orientation, 1 to 8."""
_TURNS: dict[int, Callable[[NDArray], NDArray]] = {
    2: lambda stored: stored[:, ::-1],
    3: lambda stored: stored[::-1, ::-1],
    4: lambda stored: stored[::-1],
    5: lambda stored: stored.swapaxes(0, 1),
    6: lambda stored: np.rot90(stored, -1),
    7: lambda stored: stored[::-1, ::-1].swapaxes(0, 1),
    8: np.rot90,
}
_PLAIN_TIFF = (1, 2)
"""TIFF pixel types that need no conversion: gray with 0 for black, and RGB."""
_PLAIN_MODES = ("L", "I", "F", "I;16", "I;16B", "RGB", "RGBA")
"""Pillow modes with gray or red, green, blue values."""


def read_rgb(path: Path) -> NDArray:
    """Color image [h w 3] of 8 bits: the highest bits of deeper ones, gray as three equal planes.

    Raises:
        InputError: If the file cannot be read, or is larger than `MAX_PIXELS`.
    """
    with reading(path):
        return _as_rgb(_stored(path, as_color=True))


def decoded_rgb(data: bytes) -> NDArray:
    """Color image [h w 3] of 8 bits, given the bytes of a PNG or JPEG.

    Raises:
        InputError: If they are not such a file.
    """
    with reading("an image"):
        return _as_rgb(_decoded(data, as_color=True))


def _as_rgb(stored: NDArray) -> NDArray:
    if stored.ndim == 2:
        stored = np.repeat(stored[..., None], 3, axis=-1)
    if stored.dtype == np.uint16:
        stored = (stored >> 8).astype(np.uint8)
    if stored.dtype != np.uint8 or stored.ndim != 3 or stored.shape[-1] < 3:
        raise ValueError(
            f"it is not an 8-bit or 16-bit color image, but {stored.dtype} {stored.shape}"
        )
    return np.ascontiguousarray(stored[..., :3])


def read_numbers(path: Path) -> NDArray:
    """Stored values [h w] or [h w c], planes in the order red, green, blue.

    Raises:
        InputError: If the file cannot be read.
    """
    with reading(path):
        return _stored(path, as_color=False)


def read_plane(path: Path) -> NDArray:
    """Stored values [h w] of an image with equal color planes.

    Raises:
        InputError: If the file cannot be read, or its planes differ.
    """
    stored = read_numbers(path)
    if stored.ndim == 2:
        return stored
    planes = stored[..., :3]
    if (planes != planes[..., :1]).any():
        raise InputError(f"{path} is a color image. Allowed: one number for each pixel.")
    return planes[..., 0]


def stored_steps(steps: NDArray, dtype: DTypeLike = np.uint16) -> NDArray:
    """Rounded steps of an unsigned type; 0, no value, for NaN or values out of range."""
    whole = np.rint(steps)
    is_valid = (whole >= 0) & (whole <= np.iinfo(dtype).max)
    return np.where(is_valid, whole, 0).astype(dtype)


def image_size(path: Path) -> tuple[int, int]:
    """Displayed height and width of an image; for PNG, JPEG and BMP only the header is read.

    Raises:
        InputError: If the file cannot be read.
    """
    if path.suffix.lower() in _TIFF:
        height, width = read_numbers(path).shape[:2]
        return height, width
    from PIL import Image

    with reading(path), Image.open(path, formats=_FORMATS) as image:
        is_turned = _orientation(image) >= 5
        return (image.width, image.height) if is_turned else (image.height, image.width)


def write_jpeg(path: Path, rgb: NDArray, quality: int) -> None:
    """Write a color image as JPEG without chroma subsampling."""
    write_bytes(path, jpeg_bytes(rgb, quality))


def jpeg_bytes(rgb: NDArray, quality: int) -> bytes:
    """Encode a color image as JPEG without chroma subsampling."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(rgb).save(data, "JPEG", quality=quality, subsampling=0)
    return data.getvalue()


def write_rgba(path: Path, rgba: NDArray) -> None:
    """Write an image [h w 4] of 8 bits as PNG."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(rgba).save(data, "PNG")
    write_bytes(path, data.getvalue())


def write_tiff(path: Path, array: NDArray) -> None:
    """Write values [h w] or [h w 3] of 8 or 16 bits as TIFF, losslessly compressed (Deflate)."""
    tifffile = import_extra("tifffile", "formats")

    data = io.BytesIO()
    photometric = "rgb" if array.ndim == 3 else "minisblack"
    tifffile.imwrite(data, array, photometric=photometric, compression="zlib", metadata=None)
    write_bytes(path, data.getvalue())


def _stored(path: Path, *, as_color: bool) -> NDArray:
    suffix = path.suffix.lower()
    if suffix in _TIFF:
        return _read_tiff(path, as_color)
    data = path.read_bytes()
    return decode_image(data, suffix) if suffix == ".npy" else _decoded(data, as_color=as_color)


def _decoded(data: bytes, *, as_color: bool) -> NDArray:
    """Pixel values of an image; plain PNG, which may have 16 bits, is decoded by the core."""
    from PIL import Image

    with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
        require_pixels(image.width, image.height)
        stored = None
        if image.format == "PNG":
            with suppress(ValueError):  # a palette or transparency
                stored = decode_image(data, ".png")
        stored = _by_pillow(image, as_color) if stored is None else stored
        return _turned(stored, _orientation(image))


def _by_pillow(image: Any, as_color: bool) -> NDArray:
    if image.mode == "1":
        return np.asarray(image.convert("L"))
    if as_color and image.mode not in _PLAIN_MODES:
        return np.asarray(image.convert("RGB"))
    return np.asarray(image)


def _orientation(image: Any) -> int:
    """Orientation in the EXIF data of an image; 1 without such data."""
    from PIL import Image

    exif = Image.Exif()
    with suppress(Exception):  # ignore damaged EXIF data
        exif.load(image.info.get("exif"))
    return exif.get(_ORIENTATION, 1)


def _turned(stored: NDArray, orientation: Any) -> NDArray:
    return _TURNS[orientation](stored) if orientation in _TURNS else stored


def _read_tiff(path: Path, as_color: bool) -> NDArray:
    tifffile = import_extra("tifffile", "formats")

    try:
        with tifffile.TiffFile(path) as file:
            page = file.series[0].keyframe
            if file.series[0].size > 4 * MAX_PIXELS:
                raise ValueError(f"it states an array of shape {file.series[0].shape}")
            require_pixels(page.imagewidth, page.imagelength)
            if as_color and int(page.photometric) not in _PLAIN_TIFF:
                return _decoded(path.read_bytes(), as_color=True)
            tag = page.tags.get(_ORIENTATION)
            return _turned(file.asarray(), 1 if tag is None else tag.value)
    except (ValueError, tifffile.TiffFileError) as error:
        if "imagecodecs" not in str(error):
            raise
    return _read_tiff_by_opencv(path)


def _read_tiff_by_opencv(path: Path) -> NDArray:
    """Read a TIFF with a compression that needs a codec; OpenCV applies the orientation itself."""
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("OpenCV, which reads this compression,", "formats") from error
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise ValueError("it is not a complete TIFF")
    return stored if stored.ndim == 2 else stored[..., ::-1]
