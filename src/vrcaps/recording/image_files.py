"""Images of an episode: PNG of 8 or 16 bits, and NumPy files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import MAX_PIXELS
from vrcaps.core.files import atomic_write, decode_array

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PNG_HEADER = struct.Struct(">16xII")


def write_images(items: list[tuple[Path, NDArray]]) -> None:
    """Write images in parallel: `.png` of 8 or 16 bits, [h w] or [h w 3], and `.npy`."""
    _core.write_pngs([(str(path), array) for path, array in items if path.suffix == ".png"])
    for path, array in items:
        if path.suffix == ".npy":
            with atomic_write(path) as temporary, temporary.open("wb") as file:
                np.save(file, array, allow_pickle=False)


def read_image(path: Path) -> NDArray:
    """Stored pixel values of an image written by `write_images`.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is not such an image.
    """
    return decode_image(path.read_bytes(), path.suffix)


def decode_image(data: bytes, suffix: str) -> NDArray:
    """Stored pixel values of an image, given the bytes of a file with this suffix.

    Raises:
        ValueError: If they are not such an image, or have more than `MAX_PIXELS`.
    """
    if suffix == ".npy":
        return decode_array(data)
    if len(data) >= _PNG_HEADER.size:
        require_pixels(*_PNG_HEADER.unpack_from(data))
    # The calling thread decodes a single image; this also works in forked processes.
    return _core.decode_pngs([np.frombuffer(data, np.uint8)])[0]


def require_pixels(width: int, height: int) -> None:
    """Check the image size declared in a header, before the pixels are decoded.

    Raises:
        ValueError: If it has no pixels, or more than `MAX_PIXELS`.
    """
    if not 0 < width * height <= MAX_PIXELS:
        raise ValueError(f"it states {width} x {height} pixels; allowed are 1 to {MAX_PIXELS}")
