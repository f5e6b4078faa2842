"""Organs of a label map: by ID, or by TotalSegmentator's names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import CM

if TYPE_CHECKING:
    from vrcaps.tools.ct.volume import Volume

TOTALSEGMENTATOR = {"esophagus": 15, "stomach": 6, "duodenum": 19, "small_bowel": 18, "colon": 20}
"""Gut labels of TotalSegmentator version 2, task `total` (Wasserthal et al. 2023)."""

_AIR = -900  # Hounsfield units of the air around a patient
_MISPLACED = 0.05  # fraction of a label's voxels in air outside the body above which it is suspect


def label_number(label: str) -> int:
    """ID of a label given by ID or name.

    Raises:
        UnknownNameError: If it is neither.
        InputError: If the ID is not a label.
    """
    if label.lstrip("-").isdigit():
        if int(label) < 1:
            raise InputError(f"Label {label} is background. Allowed: 1, 2, 3, …")
        return int(label)
    if label not in TOTALSEGMENTATOR:
        raise UnknownNameError("label", label, [*TOTALSEGMENTATOR, "or a number"])
    return TOTALSEGMENTATOR[label]


def check_label(labels: Volume, label: str) -> int:
    """Return the ID of a label after checking that the map contains it.

    Raises:
        InputError: If it does not, or the file contains Hounsfield units.
        UnknownNameError: If the label's name is unknown.
    """
    number = label_number(label)
    if labels.values.min() < 0:
        raise InputError(
            f"{labels.source} has values down to {labels.values.min()}: it is not a label map. "
            "Give the label map with --labels, or omit --label to segment gas."
        )
    if not (labels.values == number).any():
        labels_present = np.unique(labels.values[labels.values > 0])
        text = ", ".join(map(str, labels_present[:40])) + (
            ", …" if len(labels_present) > 40 else ""
        )
        raise InputError(
            f"No voxel of {labels.source} has label {label} ({number}). Found: {text or 'none'}."
        )
    return number


def misplaced(scan: Volume, labels: Volume, number: int) -> str | None:
    """Message if part of a label lies in the air outside the body; otherwise None.

    Args:
        scan: Hounsfield units, on the label map's grid.
        labels: The label map.
        number: ID of the label.
    """
    from vrcaps.tools.ct.lumen import body_mask

    body, stride = body_mask(scan)
    coarse = tuple(slice(None, None, s) for s in stride)
    own = labels.values[coarse] == number
    out = own & ~body & (scan.values[coarse] < _AIR)
    fraction = np.count_nonzero(out) / max(np.count_nonzero(own), 1)
    if fraction <= _MISPLACED:
        return None
    volume = fraction * np.count_nonzero(labels.values == number) * labels.voxel_volume
    return (
        f"{fraction:.0%} of the label ({volume / CM**3:.0f} ml) lies in the air outside the body: "
        "it may belong to another scan"
    )
