"""CT volumes, and the import, messages and grids of SimpleITK."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, import_extra
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from types import ModuleType

    import SimpleITK
    from jaxtyping import Float, Int, Int16

_SAME_GRID = 0.02  # maximum distance, in voxels, between the nodes of two aligned grids


_MAX_VOXELS = 1 << 30
_FINEST, _LONGEST = 1e-6, 10.0
"""Limits of the sides of voxels and of a scan [m]."""


def require_voxels(count: int, source: object) -> None:
    """Check the size of a scan before memory is allocated for it.

    Raises:
        InputError: If it has more than 2³⁰ voxels (2 GiB), such as 512 × 512 × 4096.
    """
    if count > _MAX_VOXELS:
        raise InputError(
            f"{source} states {count:.3g} voxels. Allowed: up to {_MAX_VOXELS:.3g}. "
            "Crop or coarsen the scan."
        )


def require_extent(volume: Volume) -> None:
    """Check the size of a scan's voxels and of the whole scan.

    Raises:
        InputError: If voxels are smaller than 1 µm, or a side is longer than 10 m.
    """
    spacing = volume.spacing
    sides = spacing * volume.values.shape
    if not (np.isfinite(spacing).all() and spacing.min() >= _FINEST and sides.max() <= _LONGEST):
        text = " × ".join(f"{d / MM:.3g}" for d in spacing[::-1])
        raise InputError(
            f"{volume.source} states voxels of {text} mm. Allowed: sides from 1 µm, and a scan of "
            "up to 10 m. Correct its header."
        )


def require_finite(num_bad: int, source: object) -> None:
    """Check that no voxel is NaN or infinite.

    Raises:
        InputError: If some are.
    """
    if num_bad:
        raise InputError(
            f"{source} has {num_bad} voxels that are not finite (NaN or infinite). Replace them, "
            "for example by -1024 HU (air)."
        )


def hounsfield(values: np.ndarray, source: object) -> Int16[np.ndarray, "*shape"]:
    """Convert Hounsfield units to 16-bit integers: rounded, and clipped to the range.

    Only metal on the extended scale exceeds 32,767 HU, and only padding lies below -32,768 HU.

    Args:
        values: Values of any type.
        source: File name for the message.

    Raises:
        InputError: If a value is not finite, or the values are not scalar numbers.
    """
    limits = np.iinfo(np.int16)
    if values.dtype.kind not in "iuf":
        raise InputError(f"{source} has values of type {values.dtype}. Give Hounsfield units.")
    if values.dtype.kind == "f":
        require_finite(int(np.count_nonzero(~np.isfinite(values))), source)
        values = np.rint(values)
    return np.clip(values, limits.min, limits.max).astype(np.int16)


class PatientGrid:
    """Base of all voxel arrays in the patient frame.

    Attributes:
        T_patient_index: Maps the array index (k, j, i) of a voxel to its center [m].
    """

    T_patient_index: Float[np.ndarray, "4 4"]

    @property
    def spacing(self) -> Float[np.ndarray, " 3"]:
        """Distance of neighboring voxels along k, j and i [m]."""
        return np.linalg.norm(self.T_patient_index[:3, :3], axis=0)

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel [m³]."""
        return float(abs(np.linalg.det(self.T_patient_index[:3, :3])))

    def points(self, index: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Positions [m] of array indices (k, j, i), integer or fractional."""
        return index_to_patient(self.T_patient_index, index)


@dataclass(frozen=True)
class Volume(PatientGrid):
    """Scan on a parallelepiped grid; it may be oblique, and sheared by a tilted gantry.

    The array axes are those nearest to the patient's superior, posterior and left, in this order
    (ensured by `upright`), so ``values[k]`` is an axial slice, or nearly one.

    Attributes:
        values: Hounsfield units, or label IDs.
        T_patient_index: Maps the array index (k, j, i) of a voxel to its center in the patient
            frame (DICOM LPS) [m].
        source: File or folder it was read from.
        notes: Messages to the user about how it was read, one line each.
    """

    values: Int[np.ndarray, "k j i"]
    T_patient_index: Float[np.ndarray, "4 4"]
    source: str
    notes: tuple[str, ...] = ()

    def index(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Array indices (k, j, i) of positions [m]."""
        return index_to_patient(np.linalg.inv(self.T_patient_index), points)

    def crop(self, box: tuple[slice, ...]) -> Volume:
        """Crop to a box of array indices; the values are a view."""
        return replace(
            self, values=self.values[box], T_patient_index=shifted(self.T_patient_index, box)
        )


def index_to_patient(
    transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Transform points by an affine map, such as a volume's `T_patient_index`."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def shifted(transform: Float[np.ndarray, "4 4"], box: tuple[slice, ...]) -> np.ndarray:
    """`T_patient_index` of the part of a grid in a box."""
    moved = transform.copy()
    moved[:3, 3] += transform[:3, :3] @ [part.start or 0 for part in box]
    return moved


def upright(volume: Volume) -> Volume:
    """Reorder and flip the array axes of a scan to superior, posterior, left."""
    matrix = volume.T_patient_index[:3, :3] / volume.spacing
    # Rows x, y, z of the patient; the axes of the array that follow z, y and x best.
    order, free = [], [0, 1, 2]
    for row in (2, 1, 0):
        best = max(free, key=lambda axis: abs(matrix[row, axis]))
        order.append(best)
        free.remove(best)
    values = volume.values.transpose(order)
    transform = volume.T_patient_index[:, [*order, 3]].copy()
    for axis, row in enumerate((2, 1, 0)):
        if transform[row, axis] < 0.0:
            transform[:3, 3] += transform[:3, axis] * (values.shape[axis] - 1)
            transform[:3, axis] *= -1.0
            values = np.flip(values, axis)
    return replace(volume, values=np.ascontiguousarray(values), T_patient_index=transform)


def common_part(scan: Volume, labels: Volume) -> tuple[Volume, Volume]:
    """Crop a scan and a label map to their overlap, voxel for voxel.

    Raises:
        InputError: If the two are not on one grid, or do not overlap.
    """
    step = np.linalg.solve(scan.T_patient_index, labels.T_patient_index)
    offset = np.rint(step[:3, 3]).astype(int)
    reach = np.array([*labels.values.shape, 1.0])
    drift = np.abs(step[:3] * reach - np.column_stack([np.eye(3), offset]) * reach).max()
    if drift > _SAME_GRID * max(labels.values.shape):
        raise InputError(
            f"The label map {labels.source} {_grid_text(labels)} is on another grid than the scan "
            f"{scan.source} {_grid_text(scan)}. Resample it to the scan's grid, nearest neighbor."
        )
    low = np.maximum(offset, 0)
    high = np.minimum(offset + labels.values.shape, scan.values.shape)
    if (high <= low).any():
        raise InputError(
            f"The label map {labels.source} and the scan {scan.source} do not overlap. "
            "Give labels of the same patient and scan."
        )
    of_scan = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    of_labels = tuple(slice(a, b) for a, b in zip(low - offset, high - offset, strict=True))
    return scan.crop(of_scan), labels.crop(of_labels)


def _grid_text(volume: Volume) -> str:
    size = " × ".join(str(n) for n in volume.values.shape[::-1])
    spacing = " × ".join(f"{d / MM:.3g}" for d in volume.spacing[::-1])
    x, y, z = volume.T_patient_index[:3, 3] / MM
    return f"({size} voxels of {spacing} mm from ({x:.1f}, {y:.1f}, {z:.1f}) mm)"


def import_sitk() -> ModuleType:
    """Import SimpleITK with its warnings off; their conditions are checked here.

    Raises:
        MissingExtraError: If it is not installed.
    """
    sitk = import_extra("SimpleITK", "ct")
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    return sitk


def grid_transform(image: SimpleITK.Image) -> Float[np.ndarray, "4 4"]:
    """`Volume.T_patient_index` of an image, whose own indices run (i, j, k), in millimeters."""
    direction = np.array(image.GetDirection()).reshape(3, 3)
    transform = np.eye(4)
    transform[:3, :3] = (direction * image.GetSpacing())[:, ::-1] * MM
    transform[:3, 3] = np.array(image.GetOrigin()) * MM
    return transform


def itk_reason(error: RuntimeError) -> str:
    """Line of an ITK exception that states the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return (lines[-1] if lines else type(error).__name__)[:160].rstrip(".")
