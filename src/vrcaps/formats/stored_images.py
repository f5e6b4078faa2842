"""Image files of others: read as the numbers that they hold, and written as they expect them."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError, MissingExtraError
from vrcaps.files import write_bytes
from vrcaps.recording.image_files import read_image

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
"""Suffixes of color images that are read."""
_TIFF = (".tif", ".tiff")


def read_rgb(path: Path) -> NDArray:
    """Color image [h w 3] of 8 bits: of more bits the highest, gray as three equal planes.

    Raises:
        InputError: If the file cannot be read.
    """
    stored = _stored(path, as_color=True)
    if stored.ndim == 2:
        stored = np.repeat(stored[..., None], 3, axis=-1)
    if stored.dtype == np.uint16:
        stored = (stored >> 8).astype(np.uint8)
    if stored.dtype != np.uint8 or stored.shape[-1] < 3:
        raise InputError(f"{path} is no color image of 8 or 16 bits, but {stored.dtype}.")
    return np.ascontiguousarray(stored[..., :3])


def decoded_rgb(data: bytes) -> NDArray:
    """Color image [h w 3] of 8 bits, given as the bytes of a PNG or JPEG.

    Raises:
        OSError: If they are no such file.
    """
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def read_numbers(path: Path) -> NDArray:
    """Stored numbers [h w] or [h w c], planes in the order red, green, blue.

    Raises:
        InputError: If the file cannot be read.
    """
    return _stored(path, as_color=False)


def read_plane(path: Path) -> NDArray:
    """Stored numbers [h w] of an image whose color planes all hold the same.

    Raises:
        InputError: If the file cannot be read, or its planes differ.
    """
    stored = _stored(path, as_color=False)
    if stored.ndim == 2:
        return stored
    planes = stored[..., :3]
    if (planes != planes[..., :1]).any():
        raise InputError(f"{path} is a color image. Allowed: one number for each pixel.")
    return planes[..., 0]


def stored_steps(steps: NDArray, dtype: DTypeLike = np.uint16) -> NDArray:
    """Whole steps of an unsigned type; 0, no value, where they are NaN or out of its range."""
    whole = np.rint(steps)
    is_valid = (whole >= 0) & (whole <= np.iinfo(dtype).max)
    return np.where(is_valid, whole, 0).astype(dtype)


def image_size(path: Path) -> tuple[int, int]:
    """Height and width of an image; of PNG, JPEG and BMP only the header is read.

    Raises:
        InputError: If the file cannot be read.
    """
    if path.suffix.lower() in _TIFF:
        height, width = read_numbers(path).shape[:2]
        return height, width
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.height, image.width
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error


def write_jpeg(path: Path, rgb: NDArray, quality: int) -> None:
    """Write a color image as JPEG with all its colors (no chroma subsampling)."""
    write_bytes(path, jpeg_bytes(rgb, quality))


def jpeg_bytes(rgb: NDArray, quality: int) -> bytes:
    """A color image as JPEG with all its colors (no chroma subsampling)."""
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
    """Write numbers [h w] or [h w 3] of 8 or 16 bits as TIFF, compressed without loss (Deflate)."""
    import tifffile

    data = io.BytesIO()
    photometric = "rgb" if array.ndim == 3 else "minisblack"
    tifffile.imwrite(data, array, photometric=photometric, compression="zlib", metadata=None)
    write_bytes(path, data.getvalue())


def _stored(path: Path, *, as_color: bool) -> NDArray:
    try:
        if path.suffix.lower() in _TIFF:
            return _read_tiff(path)
        if path.suffix.lower() in (".png", ".npy"):
            try:
                return read_image(path)
            except ValueError:
                if path.suffix == ".npy":
                    raise
        return _read_by_pillow(path, as_color)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error


def _read_by_pillow(path: Path, as_color: bool) -> NDArray:
    """What the core does not read: JPEG, BMP, and PNG with a palette or transparency."""
    from PIL import Image

    with Image.open(path) as image:
        if image.mode == "1":
            return np.asarray(image.convert("L"))
        if image.mode == "P" and as_color:
            return np.asarray(image.convert("RGB"))
        return np.asarray(image)


def _read_tiff(path: Path) -> NDArray:
    import tifffile

    try:
        return tifffile.imread(path)
    except (ValueError, tifffile.TiffFileError) as error:
        if "imagecodecs" not in str(error):
            raise ValueError(str(error)) from error
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("OpenCV, which reads this compression,", "formats") from error
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise ValueError("no whole TIFF")
    return stored if stored.ndim == 2 else stored[..., ::-1]
