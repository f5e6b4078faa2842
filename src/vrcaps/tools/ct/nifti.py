"""Check for non-finite NIfTI voxels, which ITK silently replaces by 0."""

from __future__ import annotations

import gzip
import zlib
from typing import IO, TYPE_CHECKING, Literal

import numpy as np

from vrcaps.errors import InputError
from vrcaps.tools.ct.volume import require_finite

if TYPE_CHECKING:
    from pathlib import Path

_FLOATS = {16: "f4", 64: "f8"}
_CHUNK = 1 << 24  # bytes read at a time
# By the header size at the start of the file: NIfTI-1, NIfTI-2.
_HEADERS = {
    348: np.dtype({"names": ["type", "start"], "formats": ["i2", "f4"], "offsets": [70, 108]}),
    540: np.dtype({"names": ["type", "start"], "formats": ["i2", "i8"], "offsets": [12, 168]}),
}


def require_finite_nifti(path: Path) -> None:
    """Check that all voxels of a NIfTI file are finite.

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
    """Number of voxels that are not finite; 0 for integer types."""
    head = file.read(max(_HEADERS))
    orders: tuple[Literal["<", ">"], ...] = ("<", ">")
    for order in orders:
        size = int(np.frombuffer(head, f"{order}i4", 1)[0])
        if size in _HEADERS:
            fields = np.frombuffer(head, _HEADERS[size].newbyteorder(order), 1)[0]
            kind = _FLOATS.get(int(fields["type"]))
            return 0 if kind is None else _count(file, int(fields["start"]), order + kind)
    return 0


def _count(file: IO[bytes] | gzip.GzipFile, start: int, dtype: str) -> int:
    """Number of values that are not finite, from an offset to the end of a file."""
    file.seek(start)
    count = 0
    while chunk := file.read(_CHUNK):
        whole = len(chunk) // np.dtype(dtype).itemsize
        count += np.count_nonzero(~np.isfinite(np.frombuffer(chunk, dtype, whole)))
    return int(count)
