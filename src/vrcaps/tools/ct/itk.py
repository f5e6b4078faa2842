"""SimpleITK, if installed, and conversion of its messages and grids."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import import_extra
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from types import ModuleType

    import SimpleITK
    from jaxtyping import Float


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
