"""Check for NIfTI voxels that ITK silently replaces by 0: not finite, or missing."""

from __future__ import annotations

import gzip
import math
import zlib
from typing import IO, TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.tools.ct.volume import require_finite

if TYPE_CHECKING:
    from pathlib import Path

_FLOATS = {16: "f4", 64: "f8"}
_CHUNK = 1 << 24  # bytes read at a time
# By the header size at the start of the file: NIfTI-1, NIfTI-2.
_HEADERS = {
    348: np.dtype(
        {
            "names": ["type", "start", "bits", "dim"],
            "formats": ["i2", "f4", "i2", "8i2"],
            "offsets": [70, 108, 72, 40],
        }
    ),
    540: np.dtype(
        {
            "names": ["type", "start", "bits", "dim"],
            "formats": ["i2", "i8", "i2", "8i8"],
            "offsets": [12, 168, 14, 16],
        }
    ),
}


def require_finite_nifti(path: Path) -> None:
    """Check that all voxels of a NIfTI file are there and finite.

    Raises:
        InputError: If some are not, or the file is truncated.
    """
    opened = gzip.open if path.name.lower().endswith(".gz") else open
    try:
        with opened(path, "rb") as file:
            count = _num_bad(file)
    except (OSError, EOFError, zlib.error, ValueError, OverflowError) as error:
        raise InputError(f"Cannot read {path}: {error}. Copy the file again.") from error
    require_finite(count, path)


def _num_bad(file: IO[bytes] | gzip.GzipFile) -> int:
    """Number of voxels that are not finite; 0 for integer types.

    Raises:
        ValueError: If there are fewer bytes than the header states.
    """
    head = file.read(max(_HEADERS))
    orders: tuple[Literal["<", ">"], ...] = ("<", ">")
    for order in orders:
        size = int(np.frombuffer(head, f"{order}i4", 1)[0])
        if size in _HEADERS:
            fields = np.frombuffer(head, _HEADERS[size].newbyteorder(order), 1)[0]
            kind = _FLOATS.get(int(fields["type"]))
            count, found = _count(file, int(fields["start"]), kind and order + kind)
            rank, *sides = map(int, fields["dim"])
            stated = math.prod(sides[:rank]) * int(fields["bits"]) // 8
            if found < stated:
                raise ValueError(f"it has {found} bytes of voxels, and its header says {stated}")
            return count
    return 0


def _count(file: IO[bytes] | gzip.GzipFile, start: int, dtype: str | None) -> tuple[int, int]:
    """Number of values that are not finite from a byte to the end of a file, and of bytes there."""
    file.seek(start)
    count = found = 0
    while chunk := file.read(_CHUNK):
        found += len(chunk)
        if dtype is not None:
            whole = len(chunk) // np.dtype(dtype).itemsize
            count += int(np.count_nonzero(~np.isfinite(np.frombuffer(chunk, dtype, whole))))
    return count, found
