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
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.core.units import MM
from vrcaps.tools.ct.dicom_headers import Listing, Series, Slice, inverted_sum, list_series
from vrcaps.tools.ct.volume import (
    Volume,
    grid_transform,
    hounsfield,
    import_sitk,
    itk_reason,
    require_extent,
    require_finite,
    require_voxels,
    upright,
)

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float

_UNEVEN = 0.5  # maximum displacement of a slice, relative to the slice spacing
_THIN = 1.5  # ratio of slice spacing to slice thickness above which slices may be missing
_MAX_PIXELS = 4096  # maximum side of a slice; scanners produce up to 2048


def read_dicom(
    folder: Path, *, series: str | None = None, progress: ProgressReport = no_report
) -> Volume:
    """Read the scan in a folder and its subfolders, slice by slice, in Hounsfield units.

    All transfer syntaxes of GDCM are supported (JPEG, JPEG-LS, JPEG 2000, RLE). Slices are ordered
    by position, not by file number. A tilted gantry is kept as a shear of `T_patient_index` without
    resampling. Values above 32,767 HU (metal) become 32,767 HU. `Volume.notes` lists skipped
    files.

    Raises:
        InputError: If there is no such series or several, slices are missing, duplicate or
            uneven, the modality is not CT, a file holds several images, or its pixels are damaged.
    """
    listing = list_series(folder)
    chosen = choose_series(list(listing.series), folder, series)
    if chosen.modality != "CT":
        raise InputError(
            f"Series {chosen.text} in {folder} is {chosen.modality}, not CT: its values are not "
            "Hounsfield units. Give a CT scan, or a label map as NIfTI."
        )
    _require_slices(chosen, folder)
    slices, step, notes = _ordered_with_notes(chosen, folder, listing)
    require_voxels(len(slices) * chosen.rows * chosen.columns, folder)
    values = np.empty((len(slices), chosen.rows, chosen.columns), np.int16)
    for number, one in enumerate(slices):
        values[number] = hounsfield(_read_pixels(one.path), one.path)
        progress(number + 1, len(slices))
    transform = np.eye(4)
    transform[:3, 0], transform[:3, 1:3] = step, chosen.axes
    transform[:3, 3] = slices[0].position
    return Volume(values, transform, str(folder), notes)


def choose_series(listed: list[Series], folder: Path, wanted: str | None) -> Series:
    """Return the only series, or the one with the given list index or UID.

    Raises:
        InputError: If there are several and none is given, or the given one does not exist.
    """
    listing = "; ".join(f"{index}: {one.text}" for index, one in enumerate(listed, start=1))
    if wanted is None:
        if len(listed) == 1:
            return listed[0]
        raise InputError(
            f"{folder} contains {len(listed)} series. Choose one with --series, by index or UID: "
            f"{listing}."
        )
    by_index = {str(index): one for index, one in enumerate(listed, start=1)}
    matches = [by_index[wanted]] if wanted in by_index else [s for s in listed if s.uid == wanted]
    if len(matches) != 1:
        raise InputError(f"No unique series {wanted!r} in {folder}. Allowed: {listing}.")
    return matches[0]


def ordered(series: Series, folder: Path) -> tuple[list[Slice], Float[np.ndarray, " 3"]]:
    """Order slices by position; return them and the step from one to the next [m].

    Raises:
        InputError: If slices are too few, missing, duplicate or out of line.
    """
    if len(series.slices) < 2:
        raise InputError(f"Series {series.text} in {folder} is a single slice. Give all of them.")
    normal = np.cross(series.axes[:, 1], series.axes[:, 0])
    normal /= np.linalg.norm(normal)
    slices = sorted(series.slices, key=lambda one: float(one.position @ normal))
    positions = np.array([one.position for one in slices])
    gaps = np.diff(positions @ normal)
    step = float(np.median(gaps))
    if step <= 0.0 or (gaps < 0.5 * step).any():
        first = int(np.argmin(gaps))
        raise InputError(
            f"Slices {slices[first].path.name} and {slices[first + 1].path.name} in {folder} "
            f"have the same position ({np.count_nonzero(gaps < 0.5 * step)} such pairs). Remove "
            "one of each."
        )
    if (gaps > 1.5 * step).any():
        first = int(np.argmax(gaps))
        missing = int(np.rint(gaps[gaps > 1.5 * step] / step - 1.0).sum())
        text = "1 slice is" if missing == 1 else f"{missing} slices are"
        raise InputError(
            f"About {text} missing in {folder}: {gaps[first] / MM:.2f} mm between "
            f"{slices[first].path.name} and {slices[first + 1].path.name}, elsewhere "
            f"{step / MM:.2f} mm. Give the whole series."
        )
    mean = (positions[-1] - positions[0]) / (len(slices) - 1)
    away = np.linalg.norm(positions - positions[0] - np.outer(np.arange(len(slices)), mean), axis=1)
    if away.max() > _UNEVEN * step:
        worst = slices[int(np.argmax(away))].path.name
        raise InputError(
            f"The slices in {folder} are unevenly spaced: {worst} lies {away.max() / MM:.2f} mm "
            "from its expected position. Give one series of even spacing, or resample it."
        )
    return slices, mean


def _ordered_with_notes(
    series: Series, folder: Path, listing: Listing
) -> tuple[list[Slice], Float[np.ndarray, " 3"], tuple[str, ...]]:
    """Order slices as `ordered` does; also return notes for the user.

    Raises:
        InputError: As `ordered`; names the files that were skipped.
    """
    notes = listing.notes()
    try:
        slices, step = ordered(series, folder)
    except InputError as error:
        raise InputError(" ".join([str(error), *(f"{note}." for note in notes)])) from error
    spacing = float(np.linalg.norm(step))
    if spacing > _THIN * series.thickness:
        notes += (
            f"slices are {spacing / MM:.2f} mm apart and {series.thickness / MM:.2f} mm thick: "
            "slices may be missing, and what lies between them is interpolated",
        )
    return slices, step, notes


def _require_slices(series: Series, folder: Path) -> None:
    """Reject files with several images or oversized ones before reading their pixels.

    Raises:
        InputError: If they contain several images, or a side is too long.
    """
    if series.frames != 1:
        name = series.slices[0].path.name
        raise InputError(
            f"{name} in {folder} is a multi-frame DICOM of {series.frames} images (enhanced CT), "
            "which is not supported. Convert the folder to NIfTI, for example with `dcm2niix "
            f"-z y {folder}`, or export the series as one file for each slice."
        )
    if max(series.columns, series.rows) > _MAX_PIXELS:
        raise InputError(
            f"Slices of series {series.text} in {folder} say that they have {series.columns} × "
            f"{series.rows} pixels. Allowed: sides up to {_MAX_PIXELS}. Export the series again."
        )


def _read_pixels(path: Path) -> np.ndarray:
    """Read the Hounsfield units of one slice: GDCM applies its rescale slope and intercept."""
    sitk = import_sitk()
    try:
        image = sitk.ReadImage(str(path), imageIO="GDCMImageIO")
        total = inverted_sum(path)
    except RuntimeError as error:
        raise InputError(f"Cannot read DICOM slice {path}: {itk_reason(error)}.") from error
    # A view would outlive the image whose memory it shows.
    values = sitk.GetArrayFromImage(image).reshape(image.GetSize()[1::-1])
    return values if total is None else total - values


_FLOATS = {16: "f4", 64: "f8"}
_CHUNK = 1 << 24  # bytes read at a time
# By the header size at the start of the file: NIfTI-1, NIfTI-2.
_HEADERS = {
    348: np.dtype(
        {
            "names": ["type", "start", "bits", "dim", "pixdim"],
            "formats": ["i2", "f4", "i2", "8i2", "8f4"],
            "offsets": [70, 108, 72, 40, 76],
        }
    ),
    540: np.dtype(
        {
            "names": ["type", "start", "bits", "dim", "pixdim"],
            "formats": ["i2", "i8", "i2", "8i8", "8f8"],
            "offsets": [12, 168, 14, 16, 104],
        }
    ),
}


def require_finite_nifti(path: Path) -> None:
    """Check that all voxels of a NIfTI file are there and finite, and have a size.

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
        ValueError: If there are fewer bytes than the header states, or voxels have no size.
    """
    head = file.read(max(_HEADERS))
    orders: tuple[Literal["<", ">"], ...] = ("<", ">")
    for order in orders:
        size = int(np.frombuffer(head, f"{order}i4", 1)[0])
        if size in _HEADERS:
            fields = np.frombuffer(head, _HEADERS[size].newbyteorder(order), 1)[0]
            kind = _FLOATS.get(int(fields["type"]))
            count, length = _count(file, int(fields["start"]), kind and order + kind)
            rank, *sides = map(int, fields["dim"])
            spacing = fields["pixdim"][1:4]
            if not (np.abs(spacing) > 0.0).all():  # of 0 or NaN, which SimpleITK reads as 1 mm
                raise ValueError(f"its header states voxels of {spacing.tolist()} mm")
            stated = math.prod(sides[:rank]) * int(fields["bits"]) // 8
            if length < stated:
                raise ValueError(f"it has {length} bytes of voxels, and its header says {stated}")
            return count
    return 0


def _count(file: IO[bytes] | gzip.GzipFile, start: int, dtype: str | None) -> tuple[int, int]:
    """Number of values that are not finite from a byte to the end of a file, and of bytes there."""
    file.seek(start)
    count = length = 0
    while chunk := file.read(_CHUNK):
        length += len(chunk)
        if dtype is not None:
            whole = len(chunk) // np.dtype(dtype).itemsize
            count += int(np.count_nonzero(~np.isfinite(np.frombuffer(chunk, dtype, whole))))
    return count, length


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
    progress: ProgressReport = no_report,
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
        volume = read_dicom(path, series=series, progress=progress)
    elif not path.exists():
        raise InputError(f"No scan at {path}. Give a DICOM folder or a NIfTI file.")
    elif not path.name.lower().endswith(FILE_TYPES):
        raise InputError(
            f"Unknown type of scan {path.name!r}. Allowed: a folder of DICOM slices, or a file "
            f"that ends in {', '.join(FILE_TYPES)}."
        )
    else:
        volume = _read_file(path, is_label_map=is_label_map)
    require_extent(volume)
    return upright(volume)


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
    match = pattern.search(head)
    first, *more = (match[1].strip() if match else b"LOCAL").splitlines() or [b""]
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
    values, name = np.empty(stored.shape, np.int16), f"label IDs of {path}"
    for k, own in enumerate(stored):  # one by one, to avoid a copy of the scan
        values[k] = narrow(own, np.int16, name) if is_label_map else hounsfield(own, path)
    return Volume(values, grid_transform(image), str(path))
