"""A folder of DICOM slices as a volume: series, order, spacing, gantry tilt, rescale."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError
from vrcaps.files import files_in
from vrcaps.tools.ct.itk import import_sitk, itk_reason
from vrcaps.tools.ct.volume import Volume, require_voxels
from vrcaps.units import MM

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float

_UNEVEN = 0.05  # of the slice spacing, by which a slice may be out of place
_MOST_PIXELS = 4096  # on a side of a slice; scanners make up to 2048
_SAME_DIRECTION = 3  # digits of direction cosines that slices of one series share

_UID, _DESCRIPTION, _MODALITY = "0020|000e", "0008|103e", "0008|0060"
_POSITION, _ORIENTATION = "0020|0032", "0020|0037"


@dataclass(frozen=True)
class Slice:
    """Where one DICOM file lies in its scan.

    Attributes:
        path: The file.
        position: Center of the first pixel, patient frame [m].
    """

    path: Path
    position: Float[np.ndarray, " 3"]


@dataclass(frozen=True)
class Series:
    """Slices of one folder that share series, orientation, size and pixel spacing.

    Attributes:
        uid: Series instance UID.
        description: What the scanner calls it.
        modality: CT, MR, …
        columns: Pixels along a row.
        rows: Pixels along a column.
        frames: Images in each file.
        axes: Steps from pixel to pixel along a column and along a row [m], as columns.
        slices: In the order they were found.
    """

    uid: str
    description: str
    modality: str
    columns: int
    rows: int
    frames: int
    axes: Float[np.ndarray, "3 2"]
    slices: tuple[Slice, ...]

    @property
    def text(self) -> str:
        """One series in a list of them."""
        return f"{self.description!r} {self.modality} {self.columns}×{self.rows}×{len(self.slices)}"


def read_dicom(
    folder: Path, *, series: str | None = None, progress: Callable[[int, int], None] | None = None
) -> Volume:
    """The scan in a folder and those below it, one slice at a time, in Hounsfield units.

    All transfer syntaxes of GDCM are read (JPEG, JPEG-LS, JPEG 2000, RLE). Slices are ordered
    by position, not by number. A tilted gantry stays a shear of `T_patient_index`: nothing
    is resampled.

    Raises:
        InputError: If there is no such series or several, slices are missing, double or
            uneven, the modality is not CT, or a file is damaged.
    """
    chosen = choose_series(list_series(folder), folder, series)
    if chosen.modality != "CT":
        raise InputError(
            f"Series {chosen.text} in {folder} is {chosen.modality}, not CT: its values are no "
            "Hounsfield units. Give a CT scan, or a label map as NIfTI."
        )
    _require_slices(chosen, folder)
    slices, step = ordered(chosen, folder)
    require_voxels(len(slices) * chosen.rows * chosen.columns, folder)
    values = np.empty((len(slices), chosen.rows, chosen.columns), np.int16)
    for number, one in enumerate(slices):
        values[number] = _read_pixels(one.path)
        if progress is not None:
            progress(number + 1, len(slices))
    transform = np.eye(4)
    transform[:3, 0], transform[:3, 1:3] = step, chosen.axes
    transform[:3, 3] = slices[0].position
    return Volume(values, transform, str(folder))


def list_series(folder: Path) -> list[Series]:
    """The series in a folder and those below it, the one with most slices first.

    Raises:
        InputError: If there is no DICOM slice.
    """
    groups: dict[tuple, list[Slice]] = {}
    about: dict[tuple, Series] = {}
    for path in files_in(folder):
        found = _read_header(path)
        if found is not None:
            key, one, series = found
            groups.setdefault(key, []).append(one)
            about.setdefault(key, series)
    if not groups:
        raise InputError(
            f"No DICOM slice in {folder}. Give the folder of a CT series, or a NIfTI file."
        )
    series = [replace(about[key], slices=tuple(slices)) for key, slices in groups.items()]
    return sorted(series, key=lambda one: -len(one.slices))


def choose_series(found: list[Series], folder: Path, wanted: str | None) -> Series:
    """The only series, or the one wanted: its number in the list, or its UID.

    Raises:
        InputError: If there are several and none, or one that is not there, is wanted.
    """
    listing = "; ".join(f"{number}: {one.text}" for number, one in enumerate(found, start=1))
    if wanted is None:
        if len(found) == 1:
            return found[0]
        raise InputError(
            f"{folder} holds {len(found)} series. Choose one by number or UID with --series: "
            f"{listing}."
        )
    numbered = {str(number): one for number, one in enumerate(found, start=1)}
    matches = [numbered[wanted]] if wanted in numbered else [s for s in found if s.uid == wanted]
    if len(matches) != 1:
        raise InputError(f"No one series {wanted!r} in {folder}. Allowed: {listing}.")
    return matches[0]


def ordered(series: Series, folder: Path) -> tuple[list[Slice], Float[np.ndarray, " 3"]]:
    """Slices by position, and the step from one to the next [m].

    Raises:
        InputError: If slices are too few, missing, double or out of line.
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
            f"Slices {slices[first].path.name} and {slices[first + 1].path.name} in {folder} lie "
            f"at one place ({np.count_nonzero(gaps < 0.5 * step)} such pairs). Remove one of each."
        )
    if (gaps > 1.5 * step).any():
        first = int(np.argmax(gaps))
        missing = int(np.rint(gaps[gaps > 1.5 * step] / step - 1.0).sum())
        raise InputError(
            f"About {missing} slices are missing in {folder}: {gaps[first] / MM:.2f} mm between "
            f"{slices[first].path.name} and {slices[first + 1].path.name}, elsewhere "
            f"{step / MM:.2f} mm. Give the whole series."
        )
    mean = (positions[-1] - positions[0]) / (len(slices) - 1)
    away = np.linalg.norm(positions - positions[0] - np.outer(np.arange(len(slices)), mean), axis=1)
    if away.max() > max(_UNEVEN * len(slices), 1.0) * step * 0.5:
        worst = slices[int(np.argmax(away))].path.name
        raise InputError(
            f"The slices in {folder} are unevenly spaced: {worst} lies {away.max() / MM:.2f} mm "
            f"beside its place. Give one series of even spacing."
        )
    return slices, mean


def _require_slices(series: Series, folder: Path) -> None:
    """Refuse files that are no single slice, or a larger one than scanners make, unread.

    Raises:
        InputError: If they hold several images, or a side is too long.
    """
    if series.frames != 1:
        raise InputError(
            f"Files of series {series.text} in {folder} hold {series.frames} images each. "
            "Allowed: 1. Export the series as one file for each slice."
        )
    if max(series.columns, series.rows) > _MOST_PIXELS:
        raise InputError(
            f"Slices of series {series.text} in {folder} say that they have {series.columns} × "
            f"{series.rows} pixels. Allowed: sides up to {_MOST_PIXELS}. Export the series again."
        )


def _read_header(path: Path) -> tuple[tuple, Slice, Series] | None:
    """Group, slice and description of a DICOM file; None for any other file."""
    sitk = import_sitk()
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError:
        return None
    if not (reader.HasMetaDataKey(_POSITION) and reader.HasMetaDataKey(_ORIENTATION)):
        return None
    text = {
        key: reader.GetMetaData(key).strip("\0 ") if reader.HasMetaDataKey(key) else ""
        for key in (_UID, _DESCRIPTION, _MODALITY, _POSITION, _ORIENTATION)
    }
    position = np.array([float(part) for part in text[_POSITION].split("\\")]) * MM
    cosines = np.array([float(part) for part in text[_ORIENTATION].split("\\")]).reshape(2, 3)
    spacing = np.array(reader.GetSpacing()[:2])  # from column to column, from row to row
    columns, rows, *depth = reader.GetSize()
    frames = math.prod(depth)
    axes = (cosines * spacing[:, None])[::-1].T * MM
    shape = (
        columns,
        rows,
        frames,
        *np.round(cosines.ravel(), _SAME_DIRECTION),
        *np.round(spacing, 4),
    )
    kind = (text[_UID], text[_DESCRIPTION], text[_MODALITY])
    about = Series(*kind, columns, rows, frames, axes, ())
    return (text[_UID], *shape), Slice(path, position), about


def _read_pixels(path: Path) -> np.ndarray:
    """Hounsfield units of one slice: GDCM applies its rescale slope and intercept."""
    sitk = import_sitk()
    try:
        image = sitk.ReadImage(str(path), sitk.sitkInt16, "GDCMImageIO")
    except RuntimeError as error:
        raise InputError(f"Cannot read DICOM slice {path}: {itk_reason(error)}.") from error
    # A copy: the view would outlive the image whose memory it shows.
    return sitk.GetArrayFromImage(image).reshape(image.GetSize()[1::-1])
