"""Files of a frame: images as PNG of 8 or 16 bits or NumPy, and the wall's vertices."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import MAX_PIXELS
from vrcaps.core.files import atomic_write, decode_array
from vrcaps.organ.organ_file import split_at_seams

if TYPE_CHECKING:
    from jaxtyping import Float32
    from numpy.typing import NDArray

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.world.model import Model, State

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
        raise ValueError(f"it declares {width} x {height} pixels. Allowed: 1 to {MAX_PIXELS}")


_DTYPE = "float32"


def wall_path(frame: int) -> str:
    """Path of a frame's wall in its episode."""
    return f"wall/{frame:06d}.npy"


def wall_to_plain(organ: OrganSurface) -> dict[str, Any]:
    """Storage format of walls, as in `episode.json`."""
    return {
        "meaning": "vertices of organ.glb in the world frame, in the order of the file",
        "path": "wall/{frame:06d}.npy",
        "dtype": _DTYPE,
        "unit": "m",
        "num_vertices": len(file_vertices(organ)),
    }


def file_vertices(organ: OrganSurface) -> np.ndarray:
    """Organ vertex index of each vertex of `organ.glb`, where texture seams are cut."""
    return split_at_seams(organ.faces, organ.uv)[0]


def stored_wall(model: Model, state: State, vertices: np.ndarray) -> Float32[np.ndarray, "k 3"]:
    """Wall of a state in stored form [m].

    Args:
        model: Model with the organ.
        state: State of the world.
        vertices: Result of `file_vertices`.
    """
    here = model.vertices_world if state.vertices_world is None else state.vertices_world
    return np.ascontiguousarray(here[vertices], _DTYPE)


def decode_wall(data: bytes) -> Float32[np.ndarray, "k 3"]:
    """Decode a stored wall from the bytes of its file.

    Raises:
        ValueError: If it is not such a file.
    """
    return decode_array(data)
