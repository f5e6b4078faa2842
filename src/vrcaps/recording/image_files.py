"""Images of an episode: PNG of 8 or 16 bits, and NumPy files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.files import atomic_write

if TYPE_CHECKING:
    from numpy.typing import NDArray


def write_images(items: list[tuple[Path, NDArray]]) -> None:
    """Write images in parallel: `.png` of 8 or 16 bits, [h w] or [h w 3], and `.npy`."""
    _core.write_pngs([(str(path), array) for path, array in items if path.suffix == ".png"])
    for path, array in items:
        if path.suffix == ".npy":
            with atomic_write(path) as temporary, temporary.open("wb") as file:
                np.save(file, array, allow_pickle=False)


def read_image(path: Path) -> NDArray:
    """Numbers stored in an image that `write_images` wrote.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is no such image.
    """
    if path.suffix == ".npy":
        return np.load(path, allow_pickle=False)
    return _core.read_png(str(path))


def decode_image(data: bytes, suffix: str) -> NDArray:
    """Numbers stored in an image, given as the bytes of a file with this suffix.

    Raises:
        ValueError: If they are no such image.
    """
    if suffix == ".npy":
        return np.load(io.BytesIO(data), allow_pickle=False)
    return _core.decode_pngs([np.frombuffer(data, np.uint8)])[0]
