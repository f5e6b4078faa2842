"""Headers of DICOM files: position, orientation and size of each slice, grouped into series."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.files import files_in
from vrcaps.core.names import is_hidden
from vrcaps.core.units import MM
from vrcaps.tools.ct.volume import import_sitk

if TYPE_CHECKING:
    import SimpleITK
    from jaxtyping import Float

_SAME_COSINE = 2e-3  # maximum difference of direction cosines within a series
_SAME_SPACING = 1e-3  # maximum difference of pixel spacing within a series
_ODD = 0.1  # size relative to the largest group of a series below which a group is dropped
_MAGIC = slice(128, 132), b"DICM"

_UID, _DESCRIPTION, _MODALITY = "0020|000e", "0008|103e", "0008|0060"
_POSITION, _ORIENTATION, _THICKNESS = "0020|0032", "0020|0037", "0018|0050"
_SPACING = "0028|0030"
_SOP_UID, _NUM_FRAMES, _PHOTOMETRIC = "0008|0018", "0028|0008", "0028|0004"


@dataclass(frozen=True)
class Slice:
    """Location of one DICOM file in its scan.

    Attributes:
        path: The file.
        position: Center of the first pixel, patient frame [m].
        sop_uid: Instance UID, empty if the file has none.
    """

    path: Path
    position: Float[np.ndarray, " 3"]
    sop_uid: str = ""


@dataclass(frozen=True)
class Series:
    """Slices of one folder that share series UID, orientation, size and pixel spacing.

    Attributes:
        uid: Series instance UID.
        description: Series description by the scanner.
        modality: CT, MR, …
        columns: Pixels along a row.
        rows: Pixels along a column.
        frames: Images in each file.
        axes: Steps from pixel to pixel along a column and along a row [m], as columns.
        thickness: Slice thickness [m]; NaN if unknown.
        slices: Slices in the order they were read.
    """

    uid: str
    description: str
    modality: str
    columns: int
    rows: int
    frames: int
    axes: Float[np.ndarray, "3 2"]
    thickness: float
    slices: tuple[Slice, ...]

    @property
    def text(self) -> str:
        """One line for a list of series."""
        count = len(self.slices) if self.frames == 1 else self.frames
        return f"{self.description!r} {self.modality} {self.columns}×{self.rows}×{count}"

    def joins(self, other: Series) -> bool:
        """Check whether slices of two descriptions belong to one stack."""
        sizes = [(one.uid, one.columns, one.rows, one.frames) for one in (self, other)]
        if sizes[0] != sizes[1]:
            return False
        (own, own_steps), (axes, steps) = _directions(self.axes), _directions(other.axes)
        same = np.abs(own - axes).max() < _SAME_COSINE
        return bool(same and np.abs(own_steps / steps - 1.0).max() < _SAME_SPACING)


@dataclass(frozen=True)
class Listing:
    """Series of a folder, and files that belong to none.

    Attributes:
        series: The one with most slices first.
        skipped: Name of each DICOM file that was skipped, and the reason.
    """

    series: tuple[Series, ...]
    skipped: tuple[tuple[str, str], ...] = ()

    def notes(self) -> tuple[str, ...]:
        """One line about skipped files, if there are any."""
        if not self.skipped:
            return ()
        named = ", ".join(f"{name} ({reason})" for name, reason in self.skipped[:3])
        more = ", …" if len(self.skipped) > 3 else ""
        noun = "file" if len(self.skipped) == 1 else "files"
        return (f"{len(self.skipped)} DICOM {noun} skipped: {named}{more}",)


class _OddFileError(Exception):
    """DICOM file that is not a slice; its text is the reason."""


def list_series(folder: Path) -> Listing:
    """List the series in a folder and its subfolders.

    Files that are not DICOM are ignored. DICOM files without an image or a usable position,
    duplicates of a slice, and slices of another size or orientation than the rest of their series
    are skipped and listed.

    Raises:
        InputError: If there is no DICOM slice.
    """
    groups: list[tuple[Series, list[Slice]]] = []
    skipped: list[tuple[str, str]] = []
    seen: dict[str, Path] = {}
    for path in files_in(folder):
        if is_hidden(Path(path.name)):
            continue
        try:
            series_list = _read_header(path)
            if series_list is None:
                continue
            about, one = series_list
            if one.sop_uid and seen.setdefault(one.sop_uid, path) != path:
                raise _OddFileError(f"copy of {seen[one.sop_uid].name}")
        except _OddFileError as error:
            skipped.append((path.name, str(error)))
            continue
        group = next((slices for series, slices in groups if series.joins(about)), None)
        if group is None:
            groups.append((about, group := []))
        group.append(one)
    series_list = [replace(about, slices=tuple(slices)) for about, slices in groups]
    kept, odd = _without_odd(sorted(series_list, key=lambda one: -len(one.slices)))
    listing = Listing(tuple(kept), (*skipped, *odd))
    if not kept:
        notes = "".join(f" {note}." for note in listing.notes())
        raise InputError(
            f"No DICOM slice in {folder}. Give the folder of a CT series, or a NIfTI file.{notes}"
        )
    return listing


def _without_odd(series: list[Series]) -> tuple[list[Series], list[tuple[str, str]]]:
    """Drop groups of few slices next to a large group of the same UID."""
    kept, odd = [], []
    for one in series:
        most = next(other for other in series if other.uid == one.uid)
        if one.frames > 1 or len(one.slices) >= _ODD * len(most.slices):
            kept.append(one)
        else:
            reason = "size or orientation differs from the rest of its series"
            odd += [(each.path.name, reason) for each in one.slices]
    return kept, odd


def _read_header(path: Path) -> tuple[Series, Slice] | None:
    """Read series and slice of a DICOM file; None for any other file.

    Raises:
        _OddFileError: If it is DICOM, but not a slice.
    """
    sitk = import_sitk()
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError:
        if path.name.upper() == "DICOMDIR" or not _is_dicom(path):
            return None
        raise _OddFileError("not an image, or damaged") from None
    if reader.GetNumberOfComponents() != 1:
        raise _OddFileError("color image")
    columns, rows, *depth = reader.GetSize()
    frames = max(math.prod(depth), int(_number(reader, _NUM_FRAMES, 1.0)))
    position, axes = np.full(3, np.nan), np.full((3, 2), np.nan)
    if frames == 1:
        position, axes = _place(reader)
    uid, description, modality = (_text(reader, key) for key in (_UID, _DESCRIPTION, _MODALITY))
    thickness = _number(reader, _THICKNESS, math.nan) * MM
    about = Series(uid, description, modality, columns, rows, frames, axes, thickness, ())
    return about, Slice(path, position, _text(reader, _SOP_UID))


def _place(
    reader: SimpleITK.ImageFileReader,
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 2"]]:
    """Position [m] and axes of a slice, see `Series`."""
    position = _numbers(reader, _POSITION, 3, "position") * MM
    cosines = _numbers(reader, _ORIENTATION, 6, "orientation").reshape(2, 3)
    if np.abs(cosines @ cosines.T - np.eye(2)).max() > 0.01:
        raise _OddFileError("orientation is not a pair of perpendicular unit vectors")
    spacing = _numbers(reader, _SPACING, 2, "pixel spacing")[::-1]  # of columns, of rows
    if spacing.min() <= 0.0:
        raise _OddFileError("pixel spacing is not positive")
    return position, (cosines * spacing[:, None])[::-1].T * MM


def _directions(axes: Float[np.ndarray, "3 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors and lengths of two axes; NaN, as in files of several frames, become 0 and 1."""
    steps = np.nan_to_num(np.linalg.norm(axes, axis=0), nan=1.0)
    return np.nan_to_num(axes) / steps, steps


def _is_dicom(path: Path) -> bool:
    part, magic = _MAGIC
    try:
        with path.open("rb") as file:
            return file.read(part.stop)[part] == magic
    except OSError:
        return False


def _text(reader: SimpleITK.ImageFileReader, key: str) -> str:
    return reader.GetMetaData(key).strip("\0 ") if reader.HasMetaDataKey(key) else ""


def _number(reader: SimpleITK.ImageFileReader, key: str, default: float) -> float:
    try:
        value = float(_text(reader, key))
    except ValueError:
        return default
    return value if math.isfinite(value) else default


def _numbers(
    reader: SimpleITK.ImageFileReader, key: str, count: int, name: str
) -> Float[np.ndarray, " n"]:
    text = _text(reader, key)
    try:
        values = np.array([float(part) for part in text.split("\\")])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise _OddFileError(f"{name} is {text[:60]}" if text else f"no {name}")
    return values


def inverted_sum(path: Path) -> float | None:
    """Sum of a value as read by GDCM and the true one if GDCM inverts them; otherwise None.

    MONOCHROME1 describes the display of values, not their meaning. GDCM complements the stored
    values v of such a file to m - v, where m is the largest of their bits, or -1 for signed ones.
    """
    sitk = import_sitk()
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    if _text(reader, _PHOTOMETRIC) != "MONOCHROME1":
        return None
    is_signed = _number(reader, "0028|0103", 0.0) == 1.0
    largest = -1.0 if is_signed else 2.0 ** _number(reader, "0028|0101", 16.0) - 1.0
    slope, intercept = _number(reader, "0028|1053", 1.0), _number(reader, "0028|1052", 0.0)
    return slope * largest + 2.0 * intercept
