"""Reader of scans and label maps: a DICOM folder, NIfTI, NRRD or MetaImage.

ITK silently replaces NIfTI voxels that are missing or not finite by 0; the reader rejects them.
"""

from __future__ import annotations

import gzip
import math
import re
import zlib
from typing import IO, TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError, narrow, reading
from vrcaps.core.names import inside
from vrcaps.tools.ct.read_dicom import read_dicom
from vrcaps.tools.ct.volume import (
    Volume,
    grid_transform,
    hounsfield,
    import_sitk,
    itk_reason,
    require_finite,
    require_voxels,
    upright,
)

if TYPE_CHECKING:
    from collections.abc import Callable
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


FILE_TYPES = (".nii", ".nii.gz", ".nrrd", ".mha", ".mhd")
_LONGEST_HEADER = 1 << 20
_META = re.compile(rb"^[ \t]*ElementDataFile[ \t]*[=:]?[ \t]*(.*)", re.MULTILINE | re.DOTALL)
_DATA_FILE = {
    ".nrrd": re.compile(rb"^data ?file:(.*)", re.MULTILINE | re.DOTALL | re.IGNORECASE),
    ".mha": _META,
    ".mhd": _META,
}
"""Files of voxels that a header names: one, or a list of lines after the word LIST."""


def read_volume(
    path: Path,
    *,
    series: str | None = None,
    is_label_map: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Read a scan or label map, 16-bit, in the patient frame (LPS, meters).

    Hounsfield units are rounded and clipped to 16 bits (see `hounsfield`); label IDs must be
    integers in this range.

    Args:
        path: A folder of DICOM slices, or a file of `FILE_TYPES`.
        series: Which series of a folder that holds several, see `choose_series`.
        is_label_map: Whether the values of a file are label IDs.
        progress: Called with the number of slices read and the total.

    Raises:
        InputError: If there is no scan, it has fewer or more than three dimensions, or (DICOM)
            several series, missing or duplicate slices; if a value is not finite, or a label ID is
            not an integer or not below 32,768.
        MissingExtraError: If SimpleITK is not installed.
    """
    if path.is_dir():
        return upright(read_dicom(path, series=series, progress=progress))
    if not path.exists():
        raise InputError(f"No scan at {path}. Give a DICOM folder or a NIfTI file.")
    if not path.name.lower().endswith(FILE_TYPES):
        raise InputError(
            f"Unknown type of scan {path.name!r}. Allowed: a folder of DICOM slices, or a file "
            f"that ends in {', '.join(FILE_TYPES)}."
        )
    return upright(_read_file(path, is_label_map=is_label_map))


def _require_bytes(path: Path, voxels: int) -> None:
    """Check that a file can hold its voxels at gzip's maximum compression ratio (1032).

    Raises:
        InputError: If it is too short.
    """
    size = path.stat().st_size
    if voxels > 1040 * size:
        raise InputError(
            f"{path} is truncated: its header states {voxels:.3g} voxels, but it has {size} bytes. "
            "Copy the file again."
        )


def _require_data_inside(path: Path) -> None:
    """Check that a header of NRRD or MetaImage names no file of voxels outside its folder.

    Raises:
        InputError: If it does, or the file cannot be read.
    """
    pattern = _DATA_FILE.get(path.suffix.lower())
    if pattern is None:
        return
    with reading(path), path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
    if path.suffix.lower() == ".nrrd":
        head = re.split(rb"\r?\n\r?\n", head, maxsplit=1)[0]
    found = pattern.search(head)
    first, *more = (found[1].strip() if found else b"LOCAL").splitlines() or [b""]
    if first.upper() == b"LOCAL":
        return
    names = more if first.upper().startswith(b"LIST") else [first]
    for name in filter(None, map(bytes.strip, names)):
        inside(path.parent, name.decode(errors="surrogateescape"))


def _read_file(path: Path, *, is_label_map: bool) -> Volume:
    _require_data_inside(path)
    sitk = import_sitk()
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        size = reader.GetSize()
        if len(size) != 3 or min(size) < 2 or reader.GetNumberOfComponents() != 1:
            raise InputError(
                f"{path} contains {' × '.join(map(str, size))} voxels of "
                f"{reader.GetNumberOfComponents()} values. Give one three-dimensional scan."
            )
        require_voxels(math.prod(size), path)
        if path.suffix.lower() != ".mhd":
            _require_bytes(path, math.prod(size))
        image = reader.Execute()
    except RuntimeError as error:
        raise InputError(f"Cannot read {path}: {itk_reason(error)}.") from error
    if path.name.lower().endswith((".nii", ".nii.gz")):
        require_finite_nifti(path)
    stored = sitk.GetArrayViewFromImage(image)
    values, name = np.empty(stored.shape, np.int16), f"label numbers of {path}"
    for k, own in enumerate(stored):  # one by one, to avoid a copy of the scan
        values[k] = narrow(own, np.int16, name) if is_label_map else hounsfield(own, path)
    return Volume(values, grid_transform(image), str(path))
