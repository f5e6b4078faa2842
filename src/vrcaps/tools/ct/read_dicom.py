"""Reader of a folder of DICOM slices: order, spacing, gantry tilt, rescale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.tools.ct.dicom_headers import Listing, Series, Slice, inverted_sum, list_series
from vrcaps.tools.ct.volume import Volume, hounsfield, import_sitk, itk_reason, require_voxels

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from jaxtyping import Float

_UNEVEN = 0.5  # maximum displacement of a slice, relative to the slice spacing
_THIN = 1.5  # ratio of slice spacing to slice thickness above which slices may be missing
_MAX_PIXELS = 4096  # maximum side of a slice; scanners produce up to 2048


def read_dicom(
    folder: Path, *, series: str | None = None, progress: Callable[[int, int], None] | None = None
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
        if progress is not None:
            progress(number + 1, len(slices))
    transform = np.eye(4)
    transform[:3, 0], transform[:3, 1:3] = step, chosen.axes
    transform[:3, 3] = slices[0].position
    return Volume(values, transform, str(folder), notes)


def choose_series(found: list[Series], folder: Path, wanted: str | None) -> Series:
    """Return the only series, or the one with the given list index or UID.

    Raises:
        InputError: If there are several and none is given, or the given one does not exist.
    """
    listing = "; ".join(f"{number}: {one.text}" for number, one in enumerate(found, start=1))
    if wanted is None:
        if len(found) == 1:
            return found[0]
        raise InputError(
            f"{folder} contains {len(found)} series. Choose one with --series, by index or UID: "
            f"{listing}."
        )
    numbered = {str(number): one for number, one in enumerate(found, start=1)}
    matches = [numbered[wanted]] if wanted in numbered else [s for s in found if s.uid == wanted]
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
            "beside its place. Give one series of even spacing, or resample it."
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
