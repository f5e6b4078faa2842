"""Cameras of layouts that store the 3×3 matrix of a pinhole without distortion.

``K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`` with pixel (0, 0) at the center of the top-left
pixel, as the loaders of these layouts use it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.core.names import listed
from vrcaps.formats.shared.stored_images import image_size

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.formats.format import Format
    from vrcaps.recording.frame_sequence import FrameSequence

_SEPARATOR = re.compile(r"[\s,;]+")


def plain_pinhole(form: Format, sequence: FrameSequence) -> LensPinhole:
    """Lens of a sequence, which must be a pinhole without distortion.

    Raises:
        InputError: If it is another lens; the message says what to do.
    """
    lens = None if sequence.camera is None else sequence.camera.lens
    if isinstance(lens, LensPinhole) and not any((lens.k1, lens.k2, lens.k3, lens.p1, lens.p2)):
        return lens
    has = "no camera" if lens is None else f"a lens of kind {lens.kind!r}"
    if isinstance(lens, LensPinhole):
        has = "a pinhole with distortion"
    raise InputError(
        f"{form.kind} holds pinholes without distortion; {sequence.name} has {has}. "
        "Add --rectify DEGREES to resample to a pinhole of that field of view."
    )


def matrix_of(lens: LensPinhole) -> Float[np.ndarray, "3 3"]:
    """K of a pinhole."""
    return np.array([[lens.fx, lens.skew, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])


def matrix_text(lens: LensPinhole, separator: str = " ") -> str:
    """Format K as three rows of text."""
    rows = (separator.join(f"{value:.12g}" for value in row) for row in matrix_of(lens))
    return "".join(f"{row}\n" for row in rows)


def read_text_numbers(path: Path) -> list[float]:
    """Read all numbers of a text file, separated by whitespace or commas.

    Raises:
        InputError: If the file cannot be read or holds anything else.
    """
    try:
        return [
            float(cell) for cell in _SEPARATOR.split(path.read_text("utf-8-sig").strip()) if cell
        ]
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {error}.") from error


def read_matrix_camera(path: Path, image: Path) -> Camera:
    """Camera from a file with the nine numbers of K.

    Raises:
        InputError: If the file cannot be read, or does not hold nine numbers.
    """
    numbers = read_text_numbers(path)
    if len(numbers) != 9:
        raise InputError(f"{path} holds {len(numbers)} numbers. Allowed: the 9 of a camera matrix.")
    fx, skew, cx, _, fy, cy, *_ = numbers
    return camera_of(LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy, skew=skew), image)


def camera_of(lens: LensPinhole, image: Path) -> Camera:
    """Camera with a lens and the image size of a file."""
    height, width = image_size(image)
    return Camera("camera", lens, width, height)


def nearest_file(folder: Path, top: Path, *patterns: str) -> Path | None:
    """First file that matches a pattern, in a folder or its parents up to `top`."""
    place = folder.resolve()
    last = top.resolve().parent
    while True:
        for pattern in patterns:
            found = listed(place, pattern)
            if found:
                return found[0]
        if place in (last, place.parent):
            return None
        place = place.parent
