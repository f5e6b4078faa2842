"""Files that are either whole or not there: written under another name, then renamed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core

if TYPE_CHECKING:
    from numpy.typing import NDArray

TEMPORARY = ".tmp"
"""End of the names of files that are still being written; they start with a dot."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, which becomes `path` if the block succeeds."""
    temporary = path.with_name(f".{path.name}{TEMPORARY}")
    try:
        yield temporary
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: Path, value: Any) -> None:
    """Write JSON, indented, in the order of the keys given; NaN is an error."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (text + "\n").encode())


def write_images(items: list[tuple[Path, NDArray]]) -> None:
    """Write images in parallel: `.png` of 8 or 16 bits, [h w] or [h w 3], and `.npy`."""
    _core.write_pngs([(str(path), array) for path, array in items if path.suffix == ".png"])
    for path, array in items:
        if path.suffix == ".npy":
            with replacing(path) as temporary, temporary.open("wb") as file:
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
