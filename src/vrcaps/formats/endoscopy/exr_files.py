"""OpenEXR images with one plane of floats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, import_extra, reading
from vrcaps.core.files import atomic_write
from vrcaps.recording.frame_files import require_pixels

if TYPE_CHECKING:
    from jaxtyping import Float


def write_exr(path: Path, plane: Float[np.ndarray, "h w"]) -> None:
    """Write a plane as float32 in red, green and blue, compressed without loss (ZIP).

    Raises:
        MissingExtraError: If OpenEXR is not installed.
    """
    exr = _openexr()
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    planes = np.repeat(plane.astype(np.float32)[..., None], 3, axis=-1)
    with atomic_write(path) as temporary, exr.File(header, {"RGB": planes}) as file:
        file.write(str(temporary))


def read_exr(path: Path) -> Float[np.ndarray, "h w"]:
    """Read the red channel of an image.

    Raises:
        InputError: If the file cannot be read, has no red channel, or exceeds `MAX_PIXELS`.
        MissingExtraError: If OpenEXR is not installed.
    """
    exr = _openexr()
    with reading(path):
        with exr.File(str(path), header_only=True) as file:
            low, high = (np.asarray(corner, int) for corner in file.header()["dataWindow"])
        width, height = (high - low + 1).tolist()
        require_pixels(width, height)
        with exr.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            pixels = channels["R"].pixels if "R" in channels else None
    if not isinstance(pixels, np.ndarray) or pixels.ndim != 2:
        raise InputError(f"{path} has no whole red channel.")
    return pixels.astype(np.float32)


def _openexr() -> Any:
    return import_extra("OpenEXR", "formats")
